"""The command ``rfpsurvey instruments``."""

from dataclasses import dataclass
from typing import Annotated

from rfpsurvey import inputs
from rfpsurvey._cli import _app
from rfpsurvey._cli._command import command
from rfpsurvey._cli._print import print_text
from rfpsurvey.errors import InputError
from rfpsurvey.inputs import Located
from rfpsurvey.instrument import Instrument, arm_classes, every_instrument, fact_texts


@dataclass(frozen=True, kw_only=True)
class InstrumentsKeys:
    """The keys of the command.

    Parameters
    ----------
    instruments : list[str], optional
        Names of presets, or paths of TOML files; if several are given, the instruments are compared. By default, all
        presets are listed.
    """

    instruments: Annotated[list[str] | None, Located] = None
    instrument: inputs.StateKeys


@command(
    InstrumentsKeys,
    "instrument.arm_model instrument.broken instrument.state_time",
    argument="instruments",
)
def instruments(keys: InstrumentsKeys) -> None:
    """List all instruments, describe one instrument with the source of every value, or compare several instruments.

    Examples
    --------
    rfpsurvey instruments
    rfpsurvey instruments lamost
    rfpsurvey instruments lamost sdss_apo mine.toml
    """
    names = keys.instruments or []
    if keys.instrument.broken is not None and len(names) != 1:
        raise InputError("--broken must be used with the name or path of one instrument")
    models = [_app.model_of(inputs.InstrumentKeys(**vars(keys.instrument), name=name)) for name in names]
    if not models:
        _print_list()
    elif len(models) == 1:
        _print_instrument(models[0])
    else:
        _print_columns(models)


def _print_list() -> None:
    print(f"{'name':<10}{'positioners':>12}{'type':>6}{'field':>10}{'layout':>10}  title")
    for known, model in every_instrument().items():
        kind, field = model.focal_plane.collision_type, f"{2 * model.field_radius.to_value('deg'):.3f} deg"
        text = f"{known:<10}{len(model.focal_plane):>12}{kind:>6}{field:>10}{model.layout:>10}  {model.title}"
        print_text(text, " " * 50)


def _print_instrument(model: Instrument) -> None:
    """Print the description of an instrument, quantities derived from its design, and the source of every value."""
    print_text(f"{model.name}: {model.title}" if model.title else model.name)
    print(f"{len(model.focal_plane)} positioners, layout {model.layout}")
    for paragraph in model.notes.strip().split("\n\n"):
        print_text(paragraph, "")
        if paragraph:
            print()
    for label, text in _texts_of(model).items():
        print_text(f"{label:<22}{text}", " " * 22)
    print()
    for row in model.to_table():
        print_text(f"{row['name']} = {row['value']} {row['unit']}".rstrip(), "    ")
        print_text(f"    {row['status']}: {row['source']}", "        ")


def _texts_of(model: Instrument) -> dict[str, str]:
    """Return the labels and values of facts; the lengths of the arms in the facts are medians of all positioners."""
    return fact_texts(model.facts() | {"arms": arm_classes(model)})


def _print_columns(models: list[Instrument]) -> None:
    """Print a table that compares several instruments, with one column for each instrument."""
    columns = [_texts_of(model) for model in models]
    widths = [max(len(model.name), *map(len, texts.values())) for model, texts in zip(models, columns, strict=True)]
    rows = {"": [model.name for model in models]}
    rows |= {label: [texts[label] for texts in columns] for label in columns[0]}
    for label, texts in rows.items():
        cells = (f"{text:<{width}}" for text, width in zip(texts, widths, strict=True))
        print(f"{label:<22}{'  '.join(cells)}".rstrip())
