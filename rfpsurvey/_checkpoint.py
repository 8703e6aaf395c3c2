"""Checks for resuming unfinished work, which is possible only if the request has not changed."""

from pathlib import Path

from rfpsurvey.errors import InputError, warn

__all__ = ["check_request", "warn_of_software"]


def check_request(path: Path, before: dict, now: dict, work: str, place: str) -> None:
    """Raise an error if the request differs from the request of the unfinished work.

    Parameters
    ----------
    path : Path
        File or folder of the unfinished work.
    before, now : dict
        The earlier and the present request; their values must be such that JSON can represent them.
    work, place : str
        Text for the error message: the kind of work, and the parameter that the user can change to begin new work.

    Raises
    ------
    InputError
        If the request differs from that of the unfinished work.
    """
    different = [name for name in sorted({*before, *now}) if before.get(name) != now.get(name)]
    if different:
        name = different[0]
        raise InputError(
            f"{path} holds another {work}: {', '.join(different)} differ ({name} was {_short(before.get(name))}, and "
            f"is {_short(now.get(name))}); give another {place}"
        )


def warn_of_software(path: Path, before: object, now: object, parts: str) -> None:
    """Issue a warning if unfinished work was begun with different versions of the software."""
    if before != now:
        text = f"{path} was begun with other versions of the software; its {parts} may differ in rounding"
        warn(text)


def _short(value: object) -> str:
    text = str(value)
    return text if len(text) <= 60 else text[:57] + "..."
