"""How allocators honor constraints."""

from dataclasses import dataclass

EXACTLY, AS_GOAL, ONLY_CHECKED = "exactly", "as a goal", "only checked"
LEVELS = (EXACTLY, AS_GOAL, ONLY_CHECKED)


@dataclass(frozen=True)
class Abilities:
    """How a method honors each part of a constraint: ``"exactly"``, ``"as a goal"`` or ``"only checked"``.

    Parameters
    ----------
    obstacles : str
        Whether arms avoid obstacles.
    precedence : str
        Whether some targets take precedence over all other targets.
    counts, distribution : str
        Whether numbers of targets are met, and whether science fibers have enough neighbors.
    motion : str
        Whether arms unfold without collisions.
    """

    obstacles: str = ONLY_CHECKED
    precedence: str = ONLY_CHECKED
    counts: str = ONLY_CHECKED
    distribution: str = ONLY_CHECKED
    motion: str = ONLY_CHECKED
