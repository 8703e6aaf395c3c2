"""Interactive views of results in notebooks."""

from dataclasses import dataclass
from html import escape

from rfpsurvey.errors import InputTypeError, check_whole
from rfpsurvey.report._blocks import Page, Section
from rfpsurvey.report._focal_plane_view import check_plans, focal_plane_view
from rfpsurvey.report._html import html_of
from rfpsurvey.report._sky_view import sky_view
from rfpsurvey.survey import Survey
from rfpsurvey.tile import Tile
from rfpsurvey.tiling import Tiling


@dataclass(frozen=True)
class NotebookView:
    """An interactive view that notebooks show in a frame; the frame cannot access the notebook, files or the network.

    Parameters
    ----------
    title : str
        Description of the result that the view shows.
    page : str
        HTML of the page in the frame.
    height : int
        Height of the frame in pixels.
    """

    title: str
    page: str
    height: int

    def _repr_html_(self) -> str:
        return (
            f'<iframe sandbox="allow-scripts" title="{escape(self.title)}" srcdoc="{escape(self.page)}" '
            f'style="width: 100%; height: {int(self.height)}px; border: 0"></iframe>'
        )

    def __repr__(self):
        return f"<NotebookView of {self.title}>"


def notebook_view(result: Tile | Survey | Tiling, *, plans: dict | None = None, height: int = 1000) -> NotebookView:
    """Return the interactive view of a tile, a survey or a tiling.

    Parameters
    ----------
    result : Tile, Survey or Tiling
        Result to show.
    plans : dict of str to Tile, optional
        Other plans of the same tile; the keys are the names of the plans. Only allowed if ``result`` is a Tile.
    height : int, optional
        Height of the frame in pixels.

    Returns
    -------
    NotebookView
        The view.

    Raises
    ------
    InputError
        If ``result`` has another type, if ``plans`` are not tiles with the same positioners, or if ``height`` is not a
        positive integer.

    Examples
    --------
    >>> from astropy.coordinates import SkyCoord
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> center = SkyCoord("6h20m +23d")
    >>> sky = rs.synthetic_catalog("uniform", center, 0.2 * u.deg, n_targets=300, rng=1)
    >>> rs.report.notebook_view(rs.plan_tile(sky, "moons", center))
    <NotebookView of a tile of moons>
    """
    check_whole(height, "height", 1)
    if isinstance(result, Tile):
        title, view = f"a tile of {result.instrument}", focal_plane_view(check_plans(result, plans), [])
    elif isinstance(result, Survey):
        radius = result.provenance["parameters"]["radius_deg"]
        title, view = f"a survey with {result.provenance['instrument']['name']}", sky_view(result.tiles, radius, [])
    elif isinstance(result, Tiling):
        title, view = "a tiling", sky_view(result.table, result.summary.get("radius_deg", 1.0), [])
    else:
        raise InputTypeError(f"result must be a Tile, a Survey or a Tiling, got {type(result).__name__}")
    page = Page("View", title[0].upper() + title[1:], "", {}, [Section(view.caption, [view])], {})
    return NotebookView(title, html_of(page, None, framed=True), int(height))
