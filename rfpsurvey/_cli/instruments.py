"""``rfpsurvey instruments``."""

from typing import Annotated

import typer

from rfpsurvey._cli import _app
from rfpsurvey.instrument import as_instrument, every_instrument

EXAMPLES = """\b
Examples:
  rfpsurvey instruments
  rfpsurvey instruments lamost
"""


@_app.app.command(epilog=EXAMPLES)
def instruments(
    name: Annotated[str | None, typer.Argument(help="Preset, or the path of a TOML file. None: list all.")] = None,
) -> None:
    """List the instruments, or show one with the source of every figure."""
    if name is None:
        print(f"{'name':<10}{'positioners':>12}{'type':>6}{'field':>10}{'layout':>10}  title")
        for known, model in every_instrument().items():
            kind, field = (
                model.focal_plane.collision_type,
                f"{2 * model.field_radius.to_value('deg'):.3f} deg",
            )
            print(f"{known:<10}{len(model.focal_plane):>12}{kind:>6}{field:>10}{model.layout:>10}  {model.title}")
        return
    model = as_instrument(name)
    print(f"{model.name}: {model.title}\n{len(model.focal_plane)} positioners, layout {model.layout}")
    print(f"{model.notes.strip()}\n")
    for row in model.to_table():
        print(
            f"{row['name']} = {row['value']} {row['unit']}".rstrip(), f"    {row['status']}: {row['source']}", sep="\n"
        )
