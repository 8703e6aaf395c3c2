"""Augmenting paths in a plan of many tiles: visits move between positioners until one more target is visited.

A candidate is an assignment that a plan may use: a positioner with a target, or with its idle arm. A path begins at a
target that requires a visit. A positioner that has another target is moved to this target, so that its previous target
loses a visit. Another positioner, of any tile, is then moved to the previous target, and so on. The path ends with a
positioner that had no target, or whose previous target is less important than the target at which the path begins.
"""

from typing import NamedTuple

import numpy as np

from rfpsurvey._jit import kernel

TOLERANCE = 1e-6
"""Rounding error of the sum of a rule over the candidates in use."""


class Links(NamedTuple):
    """The candidates of all positioners."""

    owner: np.ndarray  # positioner of each candidate
    target: np.ndarray  # -1 if its visits do not count, as those of an idle arm or of a sky position
    rank: np.ndarray  # class of the target of each candidate; smaller numbers are more important
    t_indptr: np.ndarray
    t_candidate: np.ndarray  # candidates of each target, as compressed rows
    indptr: np.ndarray
    clique: np.ndarray  # cliques of each candidate, as compressed rows; a plan uses at most one candidate of each
    r_indptr: np.ndarray
    rule: np.ndarray
    share: np.ndarray  # rules of each candidate, as compressed rows, and its share in the sum of each rule
    room: np.ndarray  # for each rule, its limit minus its sum over the candidates in use


@kernel
def exchange(old, new, links):
    """Update the rules for the use of candidate ``new`` in place of ``old``; return whether all rules are kept."""
    for k in range(links.r_indptr[old], links.r_indptr[old + 1]):
        links.room[links.rule[k]] += links.share[k]
    kept = True
    for k in range(links.r_indptr[new], links.r_indptr[new + 1]):
        links.room[links.rule[k]] -= links.share[k]
        kept &= links.room[links.rule[k]] > -TOLERANCE
    # shares in minima are negative, so that giving up a candidate can violate a rule, too
    for k in range(links.r_indptr[old], links.r_indptr[old + 1]):
        kept &= links.room[links.rule[k]] > -TOLERANCE
    return kept


@kernel
def swap(c, links, chosen, load):
    """Use candidate c for its positioner, and update the number of used candidates of each clique (``load``)."""
    i = links.owner[c]
    old = chosen[i]
    for k in range(links.indptr[old], links.indptr[old + 1]):
        load[links.clique[k]] -= 1
    for k in range(links.indptr[c], links.indptr[c + 1]):
        load[links.clique[k]] += 1
    exchange(old, c, links)
    chosen[i] = c


@kernel
def is_free(c, links, chosen, load):
    """Return whether candidate c may replace that of its positioner: no other arm collides, and all rules are kept."""
    old = chosen[links.owner[c]]
    for k in range(links.indptr[old], links.indptr[old + 1]):
        load[links.clique[k]] -= 1
    free = True
    for k in range(links.indptr[c], links.indptr[c + 1]):
        free &= load[links.clique[k]] == 0
    for k in range(links.indptr[old], links.indptr[old + 1]):
        load[links.clique[k]] += 1
    if free and links.room.size > 0:
        free = exchange(old, c, links)
        exchange(c, old, links)  # undoes the first exchange
    return free


@kernel
def last_step(t, level, replace, links, chosen, load):
    """Return a candidate of target t with which a path can end, or -1 if there is none.

    The positioner of this candidate has no target. If ``replace`` is true, the positioner may also have a target whose
    class is less important than the class ``level``.
    """
    for k in range(links.t_indptr[t], links.t_indptr[t + 1]):
        c = links.t_candidate[k]
        old = chosen[links.owner[c]]
        ends = links.target[old] < 0 or (replace and links.rank[old] > level)
        if ends and is_free(c, links, chosen, load):
            return c
    return -1


@kernel
def find_path(begin, level, replace, links, chosen, load, left, seen, stack):
    """Add a visit to the target ``begin`` along a path, and return whether such a path was found.

    A path has at most as many positioners as ``stack`` has rows. The plan is changed while the path is extended. If the
    path cannot be extended, the last change is undone, and another positioner is tried. Targets in ``seen`` are not
    tried again. ``left`` is the remaining number of visits of each target. `last_step` explains ``level`` and
    ``replace``.
    """
    seen[begin] = True
    depth = 0
    # rows: a target, the index of its next candidate (-1 if none was tried), and the candidate that lost this target
    stack[0] = begin, -1, -1
    while depth >= 0:
        t, k, _ = stack[depth]
        if k < 0:
            c = last_step(t, level, replace, links, chosen, load)
            if c >= 0:
                old = links.target[chosen[links.owner[c]]]
                swap(c, links, chosen, load)
                left[begin] -= 1
                if old >= 0:
                    left[old] += 1
                return True
            k = links.t_indptr[t]
        has_path = False
        while k < links.t_indptr[t + 1] and depth + 1 < stack.shape[0] and not has_path:
            c = links.t_candidate[k]
            k += 1
            old = chosen[links.owner[c]]
            h = links.target[old]
            if h < 0 or h == t or seen[h] or (replace and links.rank[old] > level):
                continue
            if is_free(c, links, chosen, load):
                seen[h] = has_path = True
                swap(c, links, chosen, load)
                stack[depth, 1] = k
                depth += 1
                stack[depth] = h, -1, old
        if not has_path:
            if depth > 0:
                swap(stack[depth, 2], links, chosen, load)
            depth -= 1
    return False


@kernel
def find_paths(order, level, replace, depth, links, chosen, load, left):
    """Add visits to the targets in ``order``, along paths of at most ``depth`` positioners; return the number added."""
    seen = np.zeros(left.size, np.bool_)
    stack = np.empty((depth, 3), np.int64)
    gained = 0
    for t in order:
        while left[t] > 0 and find_path(t, level, replace, links, chosen, load, left, seen, stack):
            gained += 1
    return gained
