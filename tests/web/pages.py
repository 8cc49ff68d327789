"""A browser for the tests of the page: Debian's Chromium, which draws 3D by the processor."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
READY = "html[data-ready]"
# the processor draws in 3D; /dev/shm is small in containers; root needs --no-sandbox
_ARGUMENTS = ["--enable-unsafe-swiftshader", "--disable-dev-shm-usage", "--no-sandbox"]


@contextmanager
def open_browser() -> Iterator[Any]:
    """Start Chromium, or skip the test and say why."""
    playwright = pytest.importorskip("playwright.sync_api", reason="needs playwright")
    if CHROMIUM is None:
        pytest.skip("needs Chromium (apt install chromium)")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=_ARGUMENTS)
        yield browser
        browser.close()


class Shown:
    """A report in a page of the browser, and all that the page complained of or asked for."""

    def __init__(self, browser: Any, file: Path, *, script: str = "", **options: Any) -> None:
        self.complaints: list[str] = []
        options = {
            "viewport": {"width": 1440, "height": 900},
            "reduced_motion": "reduce",
            **options,
        }
        self.context = browser.new_context(**options)
        self.context.set_default_timeout(10_000)
        self.page = self.context.new_page()
        if script:
            self.page.add_init_script(script)
        self.page.on("console", self._note_message)
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("dialog", self._note_dialog)
        self.page.on("request", lambda request: self._note_request(request.url, file.as_uri()))
        self.page.goto(file.as_uri())
        self.page.wait_for_selector(READY, timeout=30_000)

    def _note_message(self, message: Any) -> None:
        # software rendering has no hardware to be quick with, and Chromium says so
        if message.type in ("error", "warning") and "GPU stall" not in message.text:
            self.complaints.append(message.text)

    def _note_dialog(self, dialog: Any) -> None:
        self.complaints.append(f"dialog: {dialog.message}")
        dialog.dismiss()

    def _note_request(self, address: str, own: str) -> None:
        if address != own:
            self.complaints.append(f"request: {address}")

    def keep_picture(self, name: str, folder: Path) -> Path:
        """Keep a picture of the whole page: in the folder that SCREENSHOTS names, if any."""
        folder = Path(os.environ.get("SCREENSHOTS", folder))
        folder.mkdir(parents=True, exist_ok=True)
        self.page.screenshot(path=folder / name, full_page=True, timeout=60_000)
        return folder / name


# what a quick processor that has nothing else to do computes in 0.13 s
