"""A strict reader of HTML pages."""

from html.parser import HTMLParser

VOID = {"meta", "link", "br", "hr", "img", "input", "wbr"}
LOADING = {
    "src",
    "href",
    "xlink:href",
    "srcset",
    "action",
    "data",
    "poster",
    "background",
    "cite",
    "ping",
    "formaction",
}


class Reader(HTMLParser):
    """Collect the content of a page; a tag that is not closed is an error."""

    def __init__(self, text):
        super().__init__(convert_charrefs=True)
        self.stack, self.elements, self.texts, self.tables = [], [], [], []
        self.cell = None
        self.feed(text)
        self.close()
        assert not self.stack

    def handle_starttag(self, tag, attrs):
        names = [name for name, _ in attrs]
        assert len(names) == len(set(names)), (tag, names)
        attrs = dict(attrs)
        self.elements.append((tag, attrs, tuple(self.stack)))
        if tag not in VOID:
            self.stack.append(tag)
        if tag == "table":
            self.tables.append({"class": attrs["class"], "caption": "", "rows": []})
        elif tag == "tr":
            self.tables[-1]["rows"].append([])
        elif tag in ("td", "th"):
            self.cell = {"text": "", "tag": tag, **attrs}
            self.tables[-1]["rows"][-1].append(self.cell)

    def handle_startendtag(self, tag, attrs):
        assert "svg" in self.stack, tag
        self.elements.append((tag, dict(attrs), tuple(self.stack)))

    def handle_endtag(self, tag):
        assert self.stack.pop() == tag
        if tag in ("td", "th"):
            self.cell = None

    def handle_data(self, data):
        self.texts.append((self.stack[-1] if self.stack else "", data))
        if self.cell is not None:
            self.cell["text"] += data
        elif "caption" in self.stack:
            self.tables[-1]["caption"] += data

    def all(self, *tags):
        return [attrs for tag, attrs, _ in self.elements if tag in tags]

    def text(self, *tags):
        return [data for tag, data in self.texts if tag in tags]

    def table(self, caption):
        """Return the column names and rows of the only sortable table whose caption begins with the given text."""
        found = [t for t in self.tables if t["class"].split()[0] == "rows" and t["caption"].startswith(caption)]
        assert len(found) == 1, [t["caption"] for t in self.tables]
        heads, *rows = found[0]["rows"]
        return [cell["text"] for cell in heads], rows

    def facts(self):
        """Return the text of all small tables by label."""
        rows = [row for t in self.tables if t["class"] == "facts" for row in t["rows"]]
        return {label["text"]: value["text"] for label, value in rows}


def full(cell):
    """Return the full value of a cell, or NaN if it is missing."""
    value = cell.get("data-value", cell["text"])
    return float(value) if value else float("nan")
