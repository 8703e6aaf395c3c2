"""Check that unfinished work can be resumed: the request (its input and options) must not have changed."""

from pathlib import Path

from rfpsurvey.errors import InputError, warn


def check_request(path: Path, before: dict, now: dict, work: str, place: str) -> None:
    """Raise an error if the present request differs from the request with which the unfinished work began.

    Parameters
    ----------
    path : Path
        File or folder of the unfinished work.
    before, now : dict
        The request of the unfinished work, and the present request. Each request maps names to values that JSON can
        represent.
    work, place : str
        Words for the error message: the kind of work, such as "scan", and the parameter that the user can change to
        begin new work, such as "path".

    Raises
    ------
    InputError
        If the two requests differ.
    """
    different = [name for name in sorted({*before, *now}) if before.get(name) != now.get(name)]
    if different:
        name = different[0]
        raise InputError(
            f"{path} holds another {work}: {', '.join(different)} {'differs' if len(different) == 1 else 'differ'} "
            f"({name} was {_short(before.get(name))} and is now {_short(now.get(name))}); give another {place}"
        )


def warn_of_software(path: Path, before: object, now: object, parts: str) -> None:
    """Issue a warning if unfinished work was begun with different versions of the software.

    ``before`` and ``now`` contain the versions with which the work was begun, and the present versions. ``parts`` is
    the word for the results in the warning, such as "tiles".
    """
    if before != now:
        text = (
            f"{path} was begun with other versions of the software (rfpsurvey or the packages that it uses); its "
            f"{parts} may differ by rounding errors"
        )
        warn(text)


def _short(value: object) -> str:
    text = str(value)
    return text if len(text) <= 60 else text[:57] + "..."
