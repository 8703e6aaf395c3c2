"""Continue work that was begun: only the same request is continued."""

from pathlib import Path

from rfpsurvey.errors import InputError, warn

__all__ = ["check_request", "warn_of_software"]


def check_request(path: Path, before: dict, now: dict, work: str, place: str) -> None:
    """Refuse to continue another request than the one that was begun.

    Parameters
    ----------
    path : Path
        Where the work was begun.
    before, now : dict
        The requests, as JSON holds them.
    work, place : str
        What the work is, and what to give for another one, for the error.

    Raises
    ------
    InputError
        If an entry differs.
    """
    different = [name for name in sorted({*before, *now}) if before.get(name) != now.get(name)]
    if different:
        name = different[0]
        raise InputError(
            f"{path} holds another {work}: {', '.join(different)} differ ({name} was {_short(before.get(name))}, and "
            f"is {_short(now.get(name))}); give another {place}"
        )


def warn_of_software(path: Path, before: object, now: object, parts: str) -> None:
    """Warn if the work was begun with other versions of the software."""
    if before != now:
        text = f"{path} was begun with other versions of the software; its {parts} may differ in rounding"
        warn(text)


def _short(value: object) -> str:
    text = str(value)
    return text if len(text) <= 60 else text[:57] + "..."
