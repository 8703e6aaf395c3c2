"""The class `Tile`, which is the result of planning or scoring a tile."""

import json
import os
from functools import cached_property

import astropy.units as u
from astropy.coordinates import SkyCoord
from astropy.table import QTable, Table
from astropy.time import Time

from rfpsurvey._assignment.constraints.field import verdict_table
from rfpsurvey._common import io as _io
from rfpsurvey._common.descriptions import plot, show, to_html
from rfpsurvey._field.format_table import cards_of, check_tile, read_tile
from rfpsurvey._field.plan_files import write_plan
from rfpsurvey._field.table import TableOfTile, TargetsOfField, collision_shape, figure_of, same_table
from rfpsurvey._field.verdicts import OUTCOMES, completeness_table
from rfpsurvey._sky.time import to_time


class Tile:
    """The result of `plan_tile` or `score_tile`: the position of each fiber, and the arms that collide.

    Parameters
    ----------
    table : QTable
        Table with a row for each positioner. Columns: ``id``, ``spectrograph`` (if there are several), ``x``, ``y``
        (center of the positioner), ``status`` (``assigned``; ``out_of_reach``: the arm cannot reach its target;
        ``parked``: without a target, and an obstacle for other positioners; ``recorded``: the same, but in the pose
        that a scored plan records; ``idle``: without a target, and not an obstacle; ``disabled``; ``stuck``),
        ``target_id`` (masked for positioners without a target), ``ra``, ``dec`` (ICRS), ``fiber_type`` (if there are
        several), ``theta``, ``phi``, ``elbow_x``, ``elbow_y``, ``tip_x``, ``tip_y``, ``in_collision``,
        ``colliding_with`` (identifiers of the positioners and obstacles with which the arm collides, separated by
        spaces, such as ``12 obstacle-3``), ``needs_planner`` or ``without_path`` (if a constraint refers to the
        motion of the arms, see `~rfpsurvey.constraints.Motion`), ``clearance`` (distance to the nearest other arm minus
        the minimum separation), ``arm_x``, ``arm_y`` (outer end of the segment of the eccentric arm that can collide).
        The tables of `plan_tile` also have the column ``kind`` (``science``, ``standard``, ``sky``, or empty; stuck
        positioners can also observe sky), and the columns ``category`` and ``priority`` and all further columns of the
        catalog, if the catalog has them. Numbers that do not apply to a positioner are NaN, or masked if they are
        integers. The ``meta`` of the table contains ``summary``, ``provenance`` and ``geometry``.
    field_targets : QTable or TargetsOfField, optional
        All targets of the field; see `outcomes`.

    Raises
    ------
    InputError
        If the table does not describe a tile.

    Examples
    --------
    >>> from astropy.coordinates import SkyCoord
    >>> import rfpsurvey as rs
    >>> lamost = rs.Instrument.preset("lamost")
    >>> center = SkyCoord("6h20m +23d")
    >>> sky = rs.synthetic_catalog("uniform", center, lamost.field_radius, n_targets=9000, rng=1)
    >>> tile = rs.plan_tile(sky, lamost, center)
    >>> tile.summary["n_positioners"]
    4000
    """

    OUTCOMES = OUTCOMES
    """All possible outcomes of a target, such as ``observed``."""

    def __init__(self, table: QTable | TableOfTile, field_targets: QTable | TargetsOfField | None = None):
        self._made_from, self._field_targets = table, field_targets
        if isinstance(table, TableOfTile):
            return
        check_tile(table)

    @property
    def table(self) -> QTable:
        """Table with a row for each positioner; the table is made on first use."""
        if isinstance(self._made_from, TableOfTile):
            self._made_from = self._made_from.make()
        return self._made_from

    @property
    def field_targets(self) -> QTable | TargetsOfField | None:
        """All targets of the field; see `outcomes`."""
        return self._field_targets

    def __reduce__(self):
        return Tile, (self.table, self.field_targets)

    @property
    def summary(self) -> dict:
        """Counts and rates, the model of collisions and positions, and the computing time of each stage in seconds.

        For planned tiles, ``n_required`` is the number of required targets, and ``n_required_observed`` is the number
        of required targets that are assigned and not in collision.
        """
        return self._made_from.meta["summary"]

    @property
    def provenance(self) -> dict:
        """Instrument, catalog and parameters of the tile, and the versions of the software that made it."""
        return self._made_from.meta["provenance"]

    @property
    def rules(self) -> Table | None:
        """The verdict on each constraint: its number, its limit and the positioners that violate it.

        The column ``verdict`` contains ``pass``, ``fail`` or ``not checkable`` (the plan lacks the data of the
        constraint). None if there are no constraints.
        """
        records = self.summary.get("rules")
        return None if records is None else verdict_table(records)

    @property
    def instrument(self) -> str:
        """Name of the instrument."""
        return self.provenance["instrument"]["name"]

    @property
    def center(self) -> SkyCoord | None:
        """Field center (ICRS); None for tiles that were scored with positions on the focal plane."""
        parameters = self.provenance["parameters"]
        if "ra_deg" not in parameters:
            return None
        return SkyCoord(parameters["ra_deg"], parameters["dec_deg"], unit="deg")

    @property
    def position_angle(self) -> u.Quantity | None:
        """Position angle of the +y axis of the focal plane, from north toward east; None if it is unknown."""
        angle = self.provenance["parameters"].get("position_angle_deg")
        return None if angle is None else angle * u.deg

    @property
    def epoch(self) -> Time | None:
        """Epoch of the positions of the targets; None if it is unknown."""
        epoch = self.provenance["parameters"].get("epoch")
        return None if epoch is None else to_time(epoch, "epoch")

    @cached_property
    def outcomes(self) -> QTable | None:
        """Table of the outcome of each target of the field; None for scored tiles, and for tiles read from ECSV.

        Columns: ``target_id``, ``ra``, ``dec``, ``x``, ``y`` (position on the focal plane; NaN for targets that are not
        requested), ``outcome`` (one of `OUTCOMES`), ``positioner`` (identifier of the positioner to which the target is
        assigned; masked or empty if the target is not assigned), and ``kind``, ``category``, ``priority`` and the
        further columns of the catalog, if the catalog has them.
        """
        made = self.field_targets
        return made.table() if hasattr(made, "table") else made

    @property
    def targets(self) -> QTable | None:
        """The table `outcomes`, which has a row for each target of the field."""
        return self.outcomes

    @cached_property
    def completeness(self) -> QTable | None:
        """Table of the completeness: a row for each kind, each category and, for science targets, each priority.

        Columns: ``kind``, ``category``, ``priority`` (``all`` stands for all values of a column), ``n_in_field``,
        ``n_reachable`` (number of requested targets that a positioner can reach), ``n_assigned``, ``n_observed``
        (number of assigned targets that are not lost to a collision) and ``completeness``, which is ``n_observed``
        divided by ``n_in_field``. The table is None if there are no `outcomes`.
        """
        return None if self.outcomes is None else completeness_table(self.outcomes, self.summary.get("kinds", {}))

    @cached_property
    def _idle(self) -> tuple[QTable, QTable] | None:
        return self.field_targets.idle() if hasattr(self.field_targets, "idle") else None

    @property
    def idle(self) -> QTable | None:
        """Table of the positioners without a target, and the reasons; None for scored tiles, and tiles read from files.

        Columns: ``id``; ``reason`` (one of ``rfpsurvey.allocation.IDLE_REASONS``); ``n_in_reach`` (number of targets,
        among those that the allocator received, that the positioner could observe if there were no other positioners);
        ``n_free`` (number of these targets that no positioner observes, which are called free targets); ``n_possible``
        (number of free targets at which the arm would not collide if no other arm moves); ``colliding_with`` (all arms
        and obstacles with which the arm would collide at free targets, in the same format as in the table of the tile).
        """
        return None if self._idle is None else self._idle[0]

    @property
    def idle_targets(self) -> QTable | None:
        """Table of the free targets in reach of positioners without a target; None if `idle` is None.

        A target is free if no positioner observes it. Columns: ``id`` (of the positioner), ``target_id``, ``x``, ``y``,
        ``kind`` (if the catalog has it), ``possible`` (whether the arm, bent to the right or to the left, can observe
        the target without a collision) and ``colliding_with`` (all arms and obstacles with which the arm would collide
        if it is bent to the right, or if it is bent to the left).
        """
        return None if self._idle is None else self._idle[1]

    @classmethod
    def read(cls, path: str | os.PathLike) -> "Tile":
        """Read a tile from a file that `write` wrote.

        Parameters
        ----------
        path : str or path-like
            Path of the file.

        Returns
        -------
        Tile
            The tile that was written; a tile that is read from ECSV has no `outcomes`.

        Raises
        ------
        InputError
            If the file does not exist or does not contain a tile.
        """
        return cls(*read_tile(path))

    def write(
        self,
        path: str | os.PathLike,
        *,
        format: str | None = None,  # noqa: A002
        overwrite: bool = False,
    ) -> None:
        """Write the tile as FITS or ECSV; if writing fails, no incomplete file remains.

        A FITS file contains the attribute ``table`` as its first table, ``TILE``, and `outcomes`, if the tile has them,
        as its second table, ``OUTCOMES``. An ECSV file contains only ``table``, and a tile that is read from ECSV has
        neither outcomes nor completeness. To keep the outcomes, write FITS, or write ``tile.outcomes`` to a separate
        file.

        Parameters
        ----------
        path : str or path-like
            Path that ends in ``.fits`` or ``.ecsv``, optionally followed by ``.gz``.
        format : str, optional
            Format of another program, as in `~rfpsurvey.plans.write_plan`, instead of FITS or ECSV.
        overwrite : bool, optional
            Whether to replace an existing file.

        Raises
        ------
        InputError
            If the folder does not exist, if the file exists and ``overwrite`` is False, or if FITS cannot represent
            some of the text.
        """
        if format is not None:
            write_plan(self, path, format=format, overwrite=overwrite)
            return
        others = {} if self.outcomes is None else {"OUTCOMES": self.outcomes}
        _io.write_table(self.table, path, overwrite=overwrite, cards=cards_of(self), name="TILE", extensions=others)

    def plot(self, **options: object) -> object:
        """Plot the focal plane, as `rfpsurvey.plot.plot_focal_plane` does.

        Parameters
        ----------
        **options
            Parameters of `rfpsurvey.plot.plot_focal_plane`, such as ``ax`` and ``targets``.

        Returns
        -------
        matplotlib.axes.Axes
            The axes.
        """
        return plot("plot_focal_plane", self, **options)

    def show(self, plans: dict | None = None, *, height: int = 1100) -> object:
        """Return, for a notebook, the interactive view of the focal plane that a report on the tile contains.

        The view is in a frame that can run the script of the view, but has no access to the notebook or the network.

        Parameters
        ----------
        plans : dict of str to Tile, optional
            Other plans of the same tile; the keys are the names of the plans. The view shows the differences between
            any two plans.
        height : int, optional
            Height of the frame in pixels.

        Returns
        -------
        NotebookView
            Object that a notebook shows.

        Raises
        ------
        InputError
            If a plan has different positioners, or if the height is not a positive integer.

        Examples
        --------
        >>> from astropy.coordinates import SkyCoord
        >>> import rfpsurvey as rs
        >>> center = SkyCoord("6h20m +23d")
        >>> sky = rs.synthetic_catalog("uniform", center, 0.2 * u.deg, n_targets=300, rng=1)
        >>> rs.plan_tile(sky, "moons", center).show()
        <NotebookView of a tile of moons>
        """
        return show(self, plans=plans, height=height)

    def paths(self, instrument: object = None, **options: object) -> object:
        """Plan paths of all arms between the folded poses and the plan; see `rfpsurvey.collision.find_paths`.

        Parameters
        ----------
        instrument : Instrument or str, optional
            The instrument; by default, the preset with which the tile was made.
        **options
            Parameters of `rfpsurvey.collision.find_paths`, such as ``step`` and ``rng``.

        Returns
        -------
        Paths
            The proven paths.

        Raises
        ------
        InputError
            If the instrument must be given, or has other positioners, or if arms collide in the plan.
        """
        from rfpsurvey._field.score import paths_of  # scoring imports this module

        return paths_of(self, instrument, **options)

    def alternates(self, n: int = 3) -> QTable:
        """Return, for each fiber, other targets that it can observe while all other arms remain as planned.

        The arm at an alternate collides with no other arm and no obstacle, also while arms unfold if a constraint
        refers to this motion. Each alternate is checked alone; two swaps of neighbors need a new check. Alternates have
        a role of the planned target (``science`` without one), their fiber type, and are not excluded by constraints.
        Requirements, required targets, rules on the distribution of fibers, and planned paths are not checked.

        Parameters
        ----------
        n : int, optional
            Largest number of alternates of each fiber.

        Returns
        -------
        QTable
            Table with a row for each fiber and alternate. The best alternates are first: those with the highest
            priority, then the highest subpriority, then the closest ones to the fiber. Columns: ``positioner``,
            ``rank`` (from 1), ``target_id``, ``ra``, ``dec``, ``x``, ``y``, ``kind``, ``priority``, ``fiber_type``,
            ``handedness`` (the last four as far as they apply), ``planned`` (the identifier of the planned target,
            masked without one) and ``separation`` (from this target, NaN without one).

        Raises
        ------
        InputError
            If the tile was scored or read from a file, or if ``n`` is not a positive whole number.

        Examples
        --------
        >>> from astropy.coordinates import SkyCoord
        >>> import rfpsurvey as rs
        >>> center = SkyCoord("6h20m +23d")
        >>> sky = rs.synthetic_catalog("uniform", center, 0.2 * u.deg, n_targets=9000, rng=1)
        >>> rs.plan_tile(sky, "moons", center).alternates(2)["positioner", "rank", "target_id", "planned"][:2].pprint()
        positioner rank target_id planned
        ---------- ---- --------- -------
                 0    1      5645    3320
                 0    2      6507    3320
        """
        from rfpsurvey._field.alternates import alternates_of_tile  # the module is not needed otherwise

        return alternates_of_tile(self, n)

    def __len__(self):
        return self.summary["n_positioners"] if isinstance(self._made_from, TableOfTile) else len(self.table)

    def __getitem__(self, item):
        return self.table[item]

    def __eq__(self, other):
        if not isinstance(other, Tile):
            return NotImplemented
        a, b = self.table, other.table
        # compare as text, in which NaN equals NaN
        same_meta = json.dumps(a.meta, sort_keys=True) == json.dumps(b.meta, sort_keys=True)
        return same_meta and same_table(a, b) and same_table(self.outcomes, other.outcomes)

    __hash__ = None

    def _repr_html_(self) -> str:
        return to_html(self, self.summary, self.table, figure_of(self.table))

    def __repr__(self):
        s = self.summary
        return (
            f"<Tile of {self.instrument!r}: {s['n_assigned']} of {s['n_positioners']} positioners assigned"
            f"{self._kinds()}, {s['n_colliding']} in collision{collision_shape(s)}>"
        )

    def _kinds(self) -> str:
        """Return as text the number of positioners for each kind of target, unless all targets are science targets."""
        counts = {kind: row["n_assigned"] for kind, row in self.summary.get("kinds", {}).items() if row["n_assigned"]}
        return f" ({', '.join(f'{n} {kind}' for kind, n in counts.items())})" if set(counts) - {"science"} else ""
