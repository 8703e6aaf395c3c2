"""Write tables to files; the module ``read_tables`` reads them.

Output files are never incomplete, and existing files are replaced only on request. FITS headers cannot contain nested
values. The ``meta`` of a table is therefore written as one JSON string with the keyword ``RFPSURVY``, in addition to
plain cards for human readers.
"""

import gzip
import hashlib
import io
import json
import os
import secrets
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from astropy.table import QTable, Table
from astropy.units import Unit

from rfpsurvey._common.files import WRITABLE, check_new_folder, check_output, check_texts, is_fits, to_path
from rfpsurvey._common.read_documents import sentence
from rfpsurvey._common.read_fits import META_KEY
from rfpsurvey._common.read_tables import is_known
from rfpsurvey._common.temporary import temporary
from rfpsurvey.errors import InputError, listed

TEMPORARY_PREFIX = ".rfpsurvey-"
# Number of bytes of a block of a FITS file, which is also the size of a primary header without data.
BLOCK = PRIMARY = 2880
# Values of boolean columns in FITS files.
TRUE, FALSE = np.frombuffer(b"TF", dtype=np.uint8)


def write_table(
    table: QTable,
    path: str | os.PathLike,
    *,
    overwrite: bool = False,
    cards: dict | None = None,
    name: str | None = None,
    extensions: dict | None = None,
) -> None:
    """Write a table as FITS or ECSV.

    ``cards`` contains additional cards of the FITS header: a dictionary of names to values, or to tuples of a value and
    a comment. ``name`` is the name of the extension. ``extensions`` maps the names of additional extensions of a FITS
    file to their tables; an ECSV file can contain only one table.
    """
    path = to_path(path)
    for extension in (table, *(extensions or {}).values()):
        check_texts(extension, path)
    with writing_to(path, WRITABLE, overwrite=overwrite) as new_path:
        if is_fits(path):
            with _writing(f"{path}: the table", "FITS", "; write .ecsv instead"):
                _to_hdus(table, cards, name, extensions or {}).writeto(new_path)
        else:
            opener = gzip.open if path.suffix.lower() == ".gz" else open
            with _writing(f"{path}: the table", "ECSV"), opener(new_path, "wt", encoding="utf-8", newline="\n") as file:
                # astropy cannot write a quantity whose name is unit
                (Table(table) if "unit" in table.colnames else table).write(file, format="ascii.ecsv")


@contextmanager
def _writing(what: str, kind: str, remedy: str = "") -> Iterator[None]:
    """Convert all exceptions of a writer of another package to an InputError, except those of `written`."""
    try:
        yield
    except UnicodeEncodeError as error:
        if kind != "FITS":
            raise
        raise InputError(f"{what} has other text: FITS files can contain only ASCII text ({error}){remedy}") from error
    except (InputError, OSError):
        raise
    except Exception as error:  # astropy can raise any exception for columns that a format cannot represent
        raise InputError(f"{what} cannot be written as {kind}: {sentence(error)}{remedy}") from error


def check_fits_text(columns: dict, remedy: str) -> None:
    """Raise an error for text that FITS files cannot contain; ``columns`` maps descriptions to arrays of text."""
    for what, values in columns.items():
        values = np.asarray(values)
        text = np.unique(values).tolist() if values.dtype.kind == "U" else []
        bad = [value for value in text if not (value.isascii() and value.isprintable()) and value]
        if bad:
            raise InputError(
                f"FITS files can contain only printable ASCII text, but {len(bad)} {what} contain other "
                f"characters (for example, {bad[0]!r}); change this text, or {remedy}"
            )


@contextmanager
def _in_place_of(path: Path, *, overwrite: bool = True):
    """Provide a temporary path that is renamed to ``path`` on success, and removed otherwise.

    The temporary path is in a new folder beside ``path``. The folder has a random name, and other users cannot write
    into it. Therefore, no other thread or process writes into this folder, and the temporary path cannot be a symbolic
    link that another user made.
    """
    with written(path), temporary(_beside(path)) as room:
        room.mkdir(mode=0o700)
        new_path = room / path.name
        yield new_path
        if overwrite or new_path.is_dir():
            os.replace(new_path, path)
        else:
            _rename_to_new(new_path, path)


@contextmanager
def written(path: Path):
    """Convert errors of the operating system to an InputError."""
    try:
        yield
    except OSError as error:
        few = "requested and" in str(error)  # NumPy states only the numbers of bytes
        reason = error.strerror or ("some bytes cannot be stored; the disk may be full" if few else error)
        raise InputError(f"{path} cannot be written: {reason}") from error
    except UnicodeEncodeError as error:
        raise InputError(f"{path} cannot be written: text must be valid Unicode, got {error.object[:40]!a}") from None


def _beside(path: Path) -> Path:
    """Return a random path in the folder of ``path``."""
    return path.with_name(f"{TEMPORARY_PREFIX}{secrets.token_hex(8)}")


def _rename_to_new(temporary: Path, path: Path) -> None:
    """Rename a file, and raise an error if a file with the new name exists."""
    try:
        try:
            os.link(temporary, path)  # fails if the path exists, in contrast to a renaming
        except FileExistsError:
            raise
        except OSError:  # the file system has no hard links
            path.touch(exist_ok=False)
            os.replace(temporary, path)
    except FileExistsError:
        raise InputError(f"{path} exists; to replace it, use overwrite=True (or --overwrite)") from None


@contextmanager
def writing_to(path: str | os.PathLike, endings: tuple[str, ...], *, overwrite: bool = False, gzipped: bool = False):
    """Provide a temporary path beside ``path`` that is renamed to ``path`` on success."""
    path = check_output(path, endings, overwrite=overwrite, gzipped=gzipped)
    with _in_place_of(path, overwrite=overwrite) as new_path:
        yield new_path


@contextmanager
def temporary_folder(path: str | os.PathLike):
    """Provide a temporary folder beside ``path`` that is renamed to ``path`` on success."""
    path = check_new_folder(path)
    with _in_place_of(path) as new_path:
        new_path.mkdir()
        yield new_path


def _to_hdus(table, cards, name, extensions):
    """Return the header-data units (HDUs) of tables; the header of the first table has a card with its ``meta``."""
    from astropy.io import fits

    meta = {META_KEY: json.dumps(table.meta, separators=(",", ":"), default=str)}
    hdus = fits.HDUList([fits.PrimaryHDU()])
    for title, extension in {name: table, **extensions}.items():
        plain = extension.copy(copy_data=False)
        plain.meta = {}
        about = {column.info.name: column.info.description for column in plain.itercols()}
        units = {c.info.name: c.unit for c in plain.itercols() if getattr(c, "unit", None) is not None}
        odd = {key: str(unit) for key, unit in units.items() if not _is_fits_unit(unit)}
        for key in odd:
            plain[key] = np.asarray(plain[key].value)
        for column in plain.itercols():
            column.info.description = None  # the description is written to the header instead
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # ignore warnings about units and names that the FITS standard lacks
            hdu = fits.table_to_hdu(plain)
        hdu.header.update(table_cards(title, list(about), about, odd))
        hdu.header.update({**(cards or {}), **meta} if extension is table else {})
        hdus.append(hdu)
    return hdus


def _is_fits_unit(unit: object) -> bool:
    """Return whether astropy writes a unit to FITS files such that it can be read; other units are written as text."""
    try:
        return is_known(unit, Unit(unit).to_string("fits"), format="fits")
    except ValueError:
        return False


def table_cards(name: str | None, columns: list[str], about: dict, units: dict | None = None) -> dict:
    """Return FITS cards with the name of an extension, and with the descriptions and units of its columns."""
    cards = {} if name is None else {"EXTNAME": (name, "name of this table")}
    for k, column in enumerate(columns, 1):
        if about.get(column):
            cards[f"TCOMM{k}"] = about[column]
        if (units or {}).get(column):
            cards[f"TUNIT{k}"] = units[column]
    return cards


def write_bytes(path: Path, content: bytes, *, sync: bool = False) -> None:
    """Write a temporary file and rename it to ``path``; with ``sync``, the content is on disk before the renaming."""
    with written(path), temporary(_beside(path)) as new_path:
        # The file is new and has a random name, so that no other process writes to it and no link is followed.
        handle = os.open(new_path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
        with open(handle, "wb") as file:
            file.write(content)
            if sync:
                file.flush()
                os.fsync(handle)
        os.replace(new_path, path)


def write_new_file(path: Path, content: bytes) -> tuple[int, str]:
    """Write a file, make its parent folders if necessary, and return the size and the checksum of the file."""
    with written(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(path, content)
    return len(content), hashlib.sha256(content).hexdigest()


def fits_bytes(columns: dict[str, np.ndarray], cards: dict, fixed: tuple = ()) -> bytes:
    """Return the bytes of a FITS file with one table; the same columns and cards give the same bytes.

    This function is fast for thousands of small tables with the same columns, because astropy makes the header only in
    the first call: it takes 0.7 ms for the tile of a survey with 2700 visits, for which astropy takes 9 ms. The header
    contains the ``fixed`` cards, which are pairs of a name and a value; instead of a value, a tuple of a value and a
    comment is allowed. Each card in ``cards`` replaces the fixed card of the same name, or is added if there is none.
    """
    dtype = np.dtype([(name, column.dtype) for name, column in columns.items()])
    n_rows = len(next(iter(columns.values())))
    body = _fits_body(columns, n_rows, _fits_template(dtype, fixed)[-1])
    return b"".join([_fits_header(dtype, {"NAXIS2": n_rows, **cards}, fixed), body, bytes(-len(body) % BLOCK)])


class FitsRows(NamedTuple):
    """A table that is written to a FITS file in parts, so that only one part is in memory at a time."""

    dtype: np.dtype
    cards: dict  # cards of the header: a dictionary of names to values, or to tuples of a value and a comment
    parts: Iterable[np.ndarray]  # parts of the table; each part contains some of the rows


def write_fits_rows(path: str | os.PathLike, *tables: FitsRows, overwrite: bool = False) -> list[int]:
    """Write tables to a FITS file in parts, and return the number of rows of each table.

    Only one part of a table is in memory at a time, and the number of rows need not be known, unlike in astropy. For a
    catalog of a million targets, astropy takes four times as long, and 3.5 times the memory.
    """
    counts = []
    with writing_to(path, (".fits",), overwrite=overwrite) as new_path, new_path.open("wb") as file:
        for dtype, cards, parts in tables:
            fixed, n_rows, n_bytes = tuple(cards.items()), 0, 0
            disk, begin, skipped = _fits_template(dtype, fixed)[-1], file.tell(), PRIMARY if counts else 0
            file.write(_fits_header(dtype, {"NAXIS2": 0}, fixed)[skipped:])
            for rows in parts:
                n_bytes += file.write(_fits_body(rows, len(rows), disk))
                n_rows += len(rows)
            end = file.tell() + file.write(bytes(-n_bytes % BLOCK))
            file.seek(begin)
            file.write(_fits_header(dtype, {"NAXIS2": n_rows}, fixed)[skipped:])
            file.seek(end)
            counts.append(n_rows)
    return counts


def _fits_header(dtype: np.dtype, cards: dict, fixed: tuple) -> bytes:
    """Return the primary HDU and the header of a table; their size does not depend on the values in ``cards``."""
    from astropy.io import fits

    primary, header, places, _ = _fits_template(dtype, fixed)
    image = bytearray(header)
    for name, card in cards.items():
        value, comment = card if isinstance(card, tuple) else (card, "")
        place = places.get(name, len(image))  # new cards follow the existing cards
        image[place : place + 80] = str(fits.Card(name, value, comment)).encode("ascii")
    image += f"{'END':80}".encode("ascii")
    return primary + bytes(image) + b" " * (-len(image) % BLOCK)


def _fits_body(columns: np.ndarray | dict, n_rows: int, disk: np.dtype) -> bytes:
    """Return the bytes of the rows of a FITS table, without padding."""
    body = np.empty(n_rows, disk)
    for name in disk.names:
        column = columns[name]
        try:
            body[name] = np.where(column, TRUE, FALSE) if column.dtype.kind == "b" else column
        except UnicodeEncodeError as error:
            raise InputError(
                f"FITS files can contain only ASCII text, but the column {name!r} has other characters: {error}"
            ) from None
    return body.tobytes()


@lru_cache(maxsize=32)
def _fits_template(dtype: np.dtype, fixed: tuple):
    """Return the primary HDU, the header of a table, the positions of its cards, and the dtype of rows in the file."""
    from astropy.io import fits

    file = io.BytesIO()
    fits.PrimaryHDU().writeto(file)
    with _writing(f"the columns {listed(dtype.names)}", "FITS"):
        header = fits.BinTableHDU(np.zeros(1, dtype)).header
        header.update(dict(fixed))
    types = {"b": lambda t: np.dtype("u1"), "U": lambda t: np.dtype(f"S{max(t.itemsize // 4, 1)}")}
    disk = [(name, types.get(dtype[name].kind, lambda t: t.newbyteorder(">"))(dtype[name])) for name in dtype.names]
    image = header.tostring(sep="", endcard=False, padding=False).encode("ascii")
    places = {image[k : k + 8].decode().strip(): k for k in range(0, len(image), 80)}  # a long value uses several cards
    return file.getvalue(), image, places, np.dtype(disk)
