"""Reports in Chromium, driven by playwright; tests are skipped if either is missing."""

import os
import shutil
from contextlib import contextmanager

import pytest

__all__ = ["open_browser"]

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")


@contextmanager
def open_browser(ignored=""):
    """Yield a function that opens a page; it asserts at the end that no page fetched, logged or violated anything.

    Messages of the browser that begin with ``ignored`` are permitted.
    """
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    path = os.environ.get("RFPSURVEY_BROWSER") or next(filter(None, map(shutil.which, NAMES)), None)
    if path is None:
        pytest.skip("there is no Chromium here, and RFPSURVEY_BROWSER names no other browser")
    problems = []
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=path, args=["--no-sandbox", "--disable-gpu"])

        def visit(file, *, width=1400, height=1000, scheme="light", touch=False, scripts=True):
            size = {"width": width, "height": height}
            options = {"color_scheme": scheme, "has_touch": touch, "java_script_enabled": scripts}
            context = browser.new_context(viewport=size, **options)
            own = file.as_uri()

            def guard(route):
                if route.request.url.split("#")[0] == own:
                    route.continue_()
                else:
                    problems.append(f"request: {route.request.url}")
                    route.abort()

            context.route("**/*", guard)
            context.set_default_timeout(60_000)
            page = context.new_page()
            page.on("console", lambda message: problems.append(f"console: {message.text}"))
            page.on("pageerror", lambda error: problems.append(f"error: {error}"))
            page.on("dialog", lambda dialog: (problems.append(f"dialog: {dialog.message}"), dialog.dismiss()))
            page.goto(own)
            return page

        yield visit
        browser.close()
    found = [text for text in problems if not (ignored and text.startswith(ignored))]
    assert not found, found
