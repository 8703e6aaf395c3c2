import pytest

from browser import open_browser


@pytest.fixture(scope="package")
def visit():
    """Return a function that opens a page in Chromium; the tests are skipped without playwright or Chromium."""
    with open_browser() as function:
        yield function


@pytest.fixture(scope="package")
def write_view():
    """Return a function that writes a page with only the interactive view of a result, without figures and tables."""
    from rfpsurvey.report._views import notebook_view

    def write(result, path, **options):
        path.write_text(notebook_view(result, **options).page)

    return write
