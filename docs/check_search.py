"""Search the built documentation for typical questions as its page of search does; print those with another first page.

The index of a build that renewed only some pages lacks the index entries of the others; build with ``sphinx-build -a``.

python docs/check_search.py [FOLDER]
"""

import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path

QUERIES = {
    "plan a tile": "plan_tile",
    "sky fibers": "plan_tile",
    "read a FITS catalog": "plan_tile",
    "proper motion": "plan_tile",
    "units of columns": "plan_tile",
    "replan after a bad night": "history",
    "tonight": "night",
    "MUST": "modules",
    "own instrument": "instruments",
    "change the minimum separation": "howto",
    "broken positioners": "instruments",
    "export plan to fiberassign": "export",
    "collision probability": "probability",
    "compare designs": "designs",
    "guide stars": "rules",
    "requirement of standards": "rules",
    "selection probability": "selection",
    "random catalog": "selection",
    "joint plan": "joint",
    "paths of arms": "paths",
    "cluster": "surveys",
}
"""Texts as users type them, and the page that must be the first result."""
MOST_MISSES = 3
# scores of Sphinx's own search (searchtools.js)
TITLE, PARTIAL_TITLE, TERM, PARTIAL_TERM = 15, 7, 5, 2
INDEX_ENTRY, OBJECT, PARTIAL_OBJECT, OBJECT_PRIORITY = 100, 11, 6, {0: 15, 1: 5, 2: -5}


def read_index(folder: Path) -> dict:
    """Return the index of the built documentation in a folder."""
    text = (folder / "searchindex.js").read_text(encoding="utf-8")
    return json.loads(text[text.index("(") + 1 : text.rindex(")")])


def title_results(index: dict, query: str) -> Iterator[tuple[float, str, int]]:
    """Yield the score, the shown title and the page of titles and main index entries that contain the whole query."""
    for title, places in index["alltitles"].items():
        if query in title.lower() and len(query) >= len(title) / 2:
            for page, _ in places:
                own = index["titles"][page]
                shown = title if own == title else f"{own} > {title}"
                yield int(TITLE * len(query) / len(title) + 0.5) + (own == title), shown, page
    for entry, places in index["indexentries"].items():
        if query in entry and len(query) >= len(entry) / 2:
            for page, _, is_main in places:
                if is_main:
                    yield int(INDEX_ENTRY * len(query) / len(entry) + 0.5), index["titles"][page], page


def object_results(index: dict, words: list[str]) -> Iterator[tuple[float, str, int]]:
    """Yield the score, the name and the page of documented objects whose names contain one of the words."""
    for prefix, objects in index["objects"].items():
        for page, kind, priority, _, name in objects:
            full = f"{prefix}.{name}".lstrip(".").lower()
            text = f"{prefix} {name} {index['objnames'][str(kind)][2]} {index['titles'][page]}".lower()
            for word in words:
                if word in full and all(other in text for other in words):
                    last = full.split(".")[-1]
                    score = OBJECT if word in (full, last) else PARTIAL_OBJECT * (word in last)
                    yield score + OBJECT_PRIORITY.get(priority, 0), full, page


def term_results(index: dict, stems: list[str]) -> Iterator[tuple[float, str, int]]:
    """Yield the score, the title and the number of pages that contain all words."""
    scores: list[dict[int, float]] = []
    for stem in stems:
        found: dict[int, float] = {}
        for terms, exact, partial in (
            (index["terms"], TERM, PARTIAL_TERM),
            (index["titleterms"], TITLE, PARTIAL_TITLE),
        ):
            matching = [stem] if stem in terms else [one for one in terms if len(stem) > 2 and stem in one]
            for one in matching:
                pages = terms[one] if isinstance(terms[one], list) else [terms[one]]
                found |= dict.fromkeys(pages, exact if stem in terms else partial)
        scores.append(found)
    for page in set.intersection(*map(set, scores)) if scores else ():
        yield max(found[page] for found in scores), index["titles"][page], page


def search(index: dict, query: str) -> list[str]:
    """Return the names of the pages that the search finds, the best first."""
    from sphinx.search.en import SearchEnglish

    language = SearchEnglish({})
    words = list(dict.fromkeys(re.findall(r"\w+", query.lower())))
    stems = [language.stem(word) for word in words if word not in language.stopwords and not word.isdigit()]
    results = [
        *title_results(index, query.lower().strip()),
        *object_results(index, words),
        *term_results(index, list(dict.fromkeys(stems))),
    ]
    results.reverse()  # of equal results, the last one is shown first
    results.sort(key=lambda one: (-one[0], one[1].lower()))
    return list(dict.fromkeys(index["docnames"][page] for *_, page in results))


def find_misses(index: dict) -> Iterator[str]:
    """Yield a sentence for each question whose first result is another page."""
    for query, page in QUERIES.items():
        found = search(index, query)
        if found[:1] != [page]:
            yield f"search for {query!r}: {page} must be the first page, got {', '.join(found[:4]) or 'no page'}"


if __name__ == "__main__":
    folder = Path(sys.argv[1]) if sys.argv[1:] else Path(__file__).parent / "_build" / "html"
    misses = list(find_misses(read_index(folder)))
    print("\n".join([*misses, f"search: {len(QUERIES) - len(misses)} of {len(QUERIES)} questions lead to their page"]))
    sys.exit(len(misses) > MOST_MISSES)
