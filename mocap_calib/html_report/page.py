"""The page: one HTML file that holds its program, its looks and its data, and asks for nothing."""

import base64
import hashlib
import html
from functools import cache
from importlib import resources

from mocap_calib.html_report.config import ReportConfig
from mocap_calib.html_report.data import describe_report
from mocap_calib.html_report.encode import to_script
from mocap_calib.html_report.source import ReportSource

_CONFIG = ReportConfig()
_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>{style}</style>
</head>
<body>
<div id="app"></div>
<noscript>This report is drawn by a program in the page: allow JavaScript for it. The same numbers \
are in run.json beside it.</noscript>
<script type="application/json" id="report-data">{data}</script>
<script>{program}</script>
</body>
</html>
"""


def report_page(source: ReportSource) -> str:
    """Return report.html, in fewer bytes than `ReportConfig.limit`.

    Raises MismatchError where a reference does not go with the rig.
    """
    title = f"{source.title}: mocap-calib"
    empty = _fill(title, "")
    room = _CONFIG.limit - len(empty.encode())
    return _fill(title, to_script(describe_report(source, room)))


def _fill(title: str, data: str) -> str:
    """Return the page; `data` stands in it as it is."""
    program, style = _asset("page.js"), _asset("page.css")
    # nothing but what stands here may run, load or be sent
    policy = (
        f"default-src 'none'; script-src {_hash(program)}; style-src {_hash(style)}; "
        "img-src data: blob:; base-uri 'none'; form-action 'none'"
    )
    return _PAGE.format(
        policy=policy, title=html.escape(title), style=style, data=data, program=program
    )


@cache
def _asset(name: str) -> str:
    """Return a file of the bundle, which `make web` makes of the sources in web/."""
    path = resources.files("mocap_calib.html_report") / name
    return path.read_text(encoding="utf-8")


def _hash(text: str) -> str:
    """Return what a content security policy calls an element of this text."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
