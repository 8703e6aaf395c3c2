"""The folder of a survey, with a file for the result of each tile, which is called the *part* of this tile."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

from rfpsurvey._folder import RequestFolder, read_verified
from rfpsurvey.errors import InputError, warn

TABLES = ("tiles.fits", "completeness.ecsv", "outcomes.fits")
JOINT = "joint.ecsv"
OTHERS = (JOINT, "joint/state.npz")


class Folder(RequestFolder):
    """The folder of a survey, which is locked while the survey is planned.

    Parameters
    ----------
    path : str or path-like
        Path of the folder, which need not exist.
    request : dict
        The request of the survey; a survey can only be continued with the same request.
    n_tiles : int
        Number of tiles.
    resume : bool
        Whether to continue an unfinished survey.
    """

    request_name = "survey.json"
    work, parts = "survey", "tiles"

    def __init__(self, path: object, request: dict, n_tiles: int, *, resume: bool):
        super().__init__(path, request, resume=resume)
        self._n = n_tiles

    def _belongs(self, name: str) -> bool:
        stem = Path(name).stem
        return name in (*TABLES, *OTHERS) or (stem.isdigit() and int(stem) < self._n and name == part_name(int(stem)))

    def part(self, tile: int) -> bytes | None:
        """Return the stored result of the tile in row ``tile`` of the tiling, or None if there is no valid result."""
        return self._content(part_name(tile), partial(self.distrust, tile))

    def distrust(self, tile: int, reason: str) -> None:
        """Issue a warning that the stored result of a tile is not used, and that the tile is planned again."""
        warn(f"the tile in row {tile} of the tiling is planned again: {reason}")

    def put_part(self, tile: int, content: bytes) -> None:
        """Write the result of a tile to the file of this tile."""
        self.put_file(part_name(tile), content)

    def file(self, name: str) -> bytes | None:
        """Return the content of a file, or None if there is no valid file; a damaged file causes a warning."""
        return self._content(name, warn)

    def _content(self, name: str, complain: Callable[[str], None]) -> bytes | None:
        try:
            return read_verified(self.path, name, self._known) if name in self._known else None
        except InputError as error:
            complain(str(error))
            return None

    def put_file(self, name: str, content: bytes) -> None:
        """Write a file of the survey; if its parent folder does not exist, make this folder."""
        with self._told():
            (self.path / name).parent.mkdir(parents=True, exist_ok=True)
        self.put(name, content)


def part_name(tile: int) -> str:
    """Return the name of the file for the tile in row ``tile`` of the tiling."""
    return f"tiles/{tile // 1000:03d}/{tile:06d}.fits"
