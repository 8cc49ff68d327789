"""report.html in a browser: what it shows, how it moves, who can use it."""

import json
import math
from dataclasses import replace

import pytest
from pages import Shown, open_browser
from report_pages import page_data, page_of, report_source, unpack_text

pytestmark = pytest.mark.slow

EVIL = '<script>window.hacked=1</script><img src=x onerror="window.hacked=2">'
WITHOUT_WEBGL = """
const real = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {
  return kind.startsWith("webgl") ? null : real.call(this, kind, ...rest);
};
"""
# all numbers of run.json in the page: path, exact value, text, factor
FIGURES = """(root) => [...document.querySelectorAll(root + " [data-field]")].map((each) => [
  JSON.parse(each.dataset.field), JSON.parse(each.getAttribute("value")),
  each.firstChild.textContent, Number(each.dataset.scale ?? 1),
  !each.closest(".tree") && "unexplained" in each.dataset,
])"""
OPEN_ALL = """async () => {
  for (let closed; (closed = document.querySelectorAll("details:not([open])")).length;) {
    for (const each of closed) each.open = true;
    await new Promise((done) => setTimeout(done, 30));
  }
}"""


@pytest.fixture(scope="module")
def browser():
    with open_browser() as opened:
        yield opened


@pytest.fixture(scope="module")
def source():
    return report_source(cameras=4, people=3, frames=60)


@pytest.fixture(scope="module")
def file(source, tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / "report.html"
    path.write_text(page_of(source), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def shown(browser, file):
    """One page for all tests of this file; it must never complain."""
    opened = Shown(browser, file, color_scheme="light")
    yield opened
    opened.context.close()
    assert opened.complaints == []


@pytest.fixture
def page(shown):
    return shown.page


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_nothing_serious(shown, scheme, tmp_path):
    """The rules of WCAG; `moderate` and `minor` findings are printed, not refused."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="needs axe")
    shown.page.emulate_media(color_scheme=scheme)
    shown.page.wait_for_selector(f"html[data-theme={scheme}]")
    shown.keep_picture(f"report-{scheme}.png", tmp_path)
    # in dark colours, colours alone can be wrong that were not in light ones
    only = {"runOnly": ["color-contrast"]} if scheme == "dark" else {}
    options = {"resultTypes": ["violations"], **only}
    results = axe.Axe().run(shown.page, options=options).response["violations"]
    found = [
        (each["id"], each["impact"], node["html"][:200])
        for each in results
        for node in each["nodes"][:3]
    ]
    print(found)
    assert [each for each in found if each[1] in ("serious", "critical")] == []


def test_every_number_is_that_of_run_json(page, source):
    page.evaluate(OPEN_ALL)
    rows = page.evaluate(FIGURES, "")
    for select, root in (
        ("#pairs .pair select", "#pairs .pair"),
        ("#pairs > div > .bar select", "#pairs table"),
        ("#cameras .detail select", "#cameras .detail"),
    ):
        for k in range(page.locator(f"{select} option").count()):
            page.locator(select).select_option(str(k))
            rows += page.evaluate(FIGURES, root)
    run = json.loads(unpack_text(page_data(page_of(source))["run"]))
    assert run.items() <= json.loads(json.dumps(source.run)).items()
    for path, exact, text, factor, unexplained in rows:
        value = _look_up(run, path)
        assert exact == value, path
        assert _reads_as(text, value, factor), (path, text, value)
        assert not unexplained, path
    # the tree at the end has all of it
    seen = {json.dumps(path) for path, *_ in rows}
    assert {json.dumps(path) for path in _leaves(run)} <= seen


def _look_up(value, path):
    for part in path:
        value = value[part]
    return value


def _leaves(value, path=()):
    if not isinstance(value, dict | list):
        yield list(path)
        return
    items = value.items() if isinstance(value, dict) else enumerate(value)
    for key, each in items:
        yield from _leaves(each, (*path, key))


def _reads_as(text, value, factor):
    """Whether a text is a value, to three digits."""
    if value is None:
        return text == "–"
    if isinstance(value, bool):
        return text == ("yes" if value else "no")
    if isinstance(value, str):
        return text == (value or '""')
    read = float(text.replace(",", "").replace("−", "-"))
    if isinstance(value, int):
        return read == factor * value
    return math.isclose(read, factor * value, rel_tol=0.0501 if abs(read) < 1e-3 else 0.00501)


def test_it_plays_steps_and_scrubs(page):
    where, play = page.locator("output.where"), page.locator("button.play")
    page.locator("input.scrub").fill("0")
    drawn = int(page.locator("canvas.gl").get_attribute("data-drawn"))
    play.click()
    shown_frame_passes(page, 5)
    play.click()
    assert int(page.locator("canvas.gl").get_attribute("data-drawn")) > drawn + 2
    page.locator("input.scrub").fill("10")
    assert where.inner_text() == "frame 10, 0.33 s"
    page.locator("canvas.gl").focus()
    for key, frame in (("ArrowRight", 11), ("ArrowLeft", 10), ("ArrowLeft", 9), ("End", 59)):
        page.keyboard.press(key)
        assert where.inner_text().startswith(f"frame {frame},")
    for pressed in ("true", "false"):
        page.keyboard.press(" ")
        assert play.get_attribute("aria-pressed") == pressed


def shown_frame_passes(page, index):
    """Wait until the player is past a frame; the page's policy forbids Playwright's own way."""
    for _ in range(200):
        if int(page.locator("input.scrub").input_value()) > index:
            return
        page.wait_for_timeout(50)
    raise AssertionError(f"it does not play to frame {index}")


def test_a_click_on_a_camera_looks_through_it(page, source):
    found = page.evaluate(
        """() => {
          const canvas = document.querySelector("canvas.gl");
          const box = canvas.getBoundingClientRect();
          const names = new Set();
          for (let x = 10; x < box.width; x += 20) for (let y = 10; y < box.height; y += 20) {
            const place = { clientX: box.left + x, clientY: box.top + y };
            canvas.dispatchEvent(new MouseEvent("click", place));
            names.add(canvas.getAttribute("aria-label").split("Chosen camera: ")[1]);
          }
          return [...names].sort();
        }"""
    )
    assert found == [f"{name}." for name in sorted(source.rig.names)]
    page.locator("#cameras tbody").get_by_role("button", name="cam3").click()
    assert page.get_by_label("Look through").input_value() == "2"
    assert "apart (median)" in page.locator(".looking .says").inner_text()
    # other views are other pictures
    canvas = page.locator("canvas.gl")
    pictures = [canvas.screenshot()]
    canvas.focus()
    for key in ("Shift+ArrowLeft", "+"):
        page.keyboard.press(key)
        pictures.append(canvas.screenshot())
    page.get_by_label("Follow").select_option("1")
    pictures.append(canvas.screenshot())
    assert len(set(pictures)) == len(pictures)
    page.get_by_role("button", name="Whole rig").click()


def test_an_explanation_comes_by_keyboard_and_by_mouse(page):
    tip = page.get_by_role("tooltip", include_hidden=True)
    number = page.locator(".tile .figure").first
    page.mouse.move(0, 0)
    number.focus()
    assert tip.is_visible()
    assert "verdict.rotation_sigma_deg.max" in tip.inner_text()
    assert number.get_attribute("aria-describedby") == tip.get_attribute("id")
    page.keyboard.press("Escape")
    assert not tip.is_visible()
    page.locator("#cameras tbody .figure").first.hover()
    assert "Rotation uncertainty" in tip.inner_text()


def test_names_are_text_and_never_a_program(browser, source, tmp_path):
    """A camera, a joint, the title, a reason: all of them from files."""
    text = json.dumps(source.run)
    for name in source.rig.names:
        text = text.replace(json.dumps(name), json.dumps(EVIL + name))
    run = json.loads(text) | {"left_out": [EVIL]}
    run["verdict"] |= {"rig": EVIL, "reasons": [f"{EVIL}; {EVIL}"]}
    cameras = tuple(replace(each, name=EVIL + each.name) for each in source.rig.cameras)
    joints = tuple(EVIL + name for name in source.poses.keypoints)
    rig, poses = replace(source.rig, cameras=cameras), replace(source.poses, keypoints=joints)
    changes = {"title": EVIL, "run": run, "rig": rig, "poses": poses, "notes": (EVIL,)}
    path = tmp_path / "report.html"
    path.write_text(page_of(source, rig, **changes), encoding="utf-8")
    shown = Shown(browser, path)
    shown.page.evaluate(OPEN_ALL)
    assert shown.page.evaluate("window.hacked") is None
    assert shown.page.locator("img").count() == 0
    assert shown.page.locator("script").count() == 2  # the data and the program
    assert shown.page.locator("h1 .name").inner_text() == EVIL
    assert EVIL in shown.page.locator("#cameras .joints").inner_text()
    # the rig laid over itself
    assert shown.page.locator("#reference tbody tr").count() == 4
    assert shown.complaints == []
    shown.context.close()


def test_without_webgl_it_says_so_and_shows_the_rest(browser, file):
    shown = Shown(browser, file, script=WITHOUT_WEBGL)
    assert "needs WebGL" in shown.page.locator(".stage.static").inner_text()
    shown.page.locator("button.play").click()
    shown_frame_passes(shown.page, 2)
    assert shown.page.locator("section").count() >= 6
    assert [each for each in shown.complaints if "WebGL" not in each] == []
    shown.context.close()
