"""Tools of the page: a slice of the map between two heights, and a cloud that is moved by hand and registered."""

from __future__ import annotations

import re

import numpy as np
import pytest

from revisit import Client
from revisit.core.geometry import se3
from revisit.formats.glb import encode_scene
from revisit.service.rest.routes.page import WEB
from tests.support.browser import PHONE, Page
from tests.support.live_service import live_service
from tests.support.page_town import EACH_BY_ITSELF, fill
from tests.support.patience import eventually
from tests.support.service_world import cloud_points

TOWN = "maps/town"

PIXELS = """() => {
  const view = revisitPage.view(), gl = view.renderer.getContext();
  view.grid.visible = false;
  view.paint();
  const [width, height] = [gl.drawingBufferWidth, gl.drawingBufferHeight];
  const bytes = new Uint8Array(4 * width * height);
  gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
  const pixels = new Uint32Array(bytes.buffer);
  return pixels.reduce((count, pixel) => count + (pixel !== pixels[0]), 0);
}"""
"""How many pixels are not empty, without the grid that lies underneath."""


@pytest.fixture(scope="module")
def service():
    """A map `town` of two sessions, eight submaps in all, with points from 8 m below to 8 m above."""
    with live_service(pipeline=EACH_BY_ITSELF) as running, Client(running.http) as client:
        fill(client)
        encode_scene(np.eye(3), np.array([[0, 1, 2]]))  # compiled before it is asked for
        yield running


@pytest.fixture(scope="module")
def opened(chromium, service):
    shown = Page(chromium, service.http, "/#maps/town", viewport={"width": 700, "height": 500})
    shown.drawn()
    yield shown
    assert shown.complaints == []
    shown.tab.close()


@pytest.fixture
def page(opened):
    """One page for all tests, with every height and no points shown."""
    yield opened
    opened.tab.evaluate("""() => {
        const view = revisitPage.view();
        revisitPage.slice().clear();
        revisitPage.select(null);
        view.cut(-Infinity, Infinity);
        view.measure([]);
        view.showPlans([]);
        view.showSurface("none");
    }""")


@pytest.fixture
def fresh(chromium, service):
    """A page of its own, for a test that adds loop closures to the map or leaves a dialog."""
    shown = Page(chromium, service.http, f"/#{TOWN}")
    shown.drawn()
    yield shown
    shown.tab.close()


def drawn(page, low_m: float, high_m: float) -> int:
    page.tab.evaluate("([low, high]) => revisitPage.view().cut(low, high)", [low_m, high_m])
    return page.tab.evaluate(PIXELS)


@pytest.mark.parametrize(
    "surface",
    ["none", "points", pytest.param("mesh", marks=pytest.mark.slow), pytest.param("height", marks=pytest.mark.slow)],
)
def test_drives_loops_points_and_surfaces_are_cut_alike(page, surface):
    if surface == "height":
        page.tab.select_option("#colour-by", "height")
    if surface != "none":
        page.tab.locator(f"#surface [data-surface={'points' if surface == 'height' else surface}]").click()
        eventually(lambda: page.tab.evaluate("revisitPage.view().surfaces.children.length") == 8)
    whole, around, above, below = (drawn(page, *ends) for ends in ((-50, 50), (-1, 2), (20, 50), (-50, -20)))
    assert whole > 300 and above == below == 0
    assert around < 0.9 * whole if surface in ("points", "height") else around == whole


def test_every_shader_of_the_scene_knows_the_slice():
    text = (WEB / "scene.js").read_text()
    ends = {"vertex": text.count("gl_Position ="), "fragment": text.count("gl_FragColor =")}
    for kind, shaders in ends.items():
        assert shaders == text.count(f"#include <clipping_planes_{kind}>") > 0
        assert shaders == text.count(f"#include <clipping_planes_pars_{kind}>")


def test_a_mark_and_a_ruler_are_cut_with_what_they_mark_and_a_plan_below_is_not(page):
    submap = "maps/town/sessions/monday/submaps/m2"
    drawn(page, 20.0, 50.0)
    page.tab.evaluate("name => revisitPage.select({ submap: name })", submap)
    page.tab.evaluate(
        """name => {
        const view = revisitPage.view(), at = view.places.get(name).at;
        view.measure([at.clone(), at.clone().setX(30)]);
    }""",
        submap,
    )
    assert page.tab.evaluate(PIXELS) == 0
    page.tab.evaluate("""() => {
        const image = new ImageData(new Uint8ClampedArray(16).fill(200), 2, 2);
        const corners = [[0, 20], [20, 20], [20, 0], [0, 0]];
        revisitPage.view().showPlans([{ name: "p", image, opacity: 1, corners, height: 0 }]);
    }""")
    assert page.tab.evaluate(PIXELS) > 1000
    assert drawn(page, -50.0, -20.0) == 0, "it would lie above the slice"


def test_what_is_cut_away_is_not_picked(page):
    submap = "maps/town/sessions/monday/submaps/m2"
    at = page.tab.evaluate("name => revisitPage.whereIs(name)", submap)
    found = "([x, y]) => revisitPage.view().nearest(x, y)?.submap?.name ?? null"
    assert page.tab.evaluate(found, [at["x"], at["y"]]) == submap
    drawn(page, 1.0, 5.0)
    assert page.tab.evaluate(found, [at["x"], at["y"]]) is None


def test_the_keyboard_alone_cuts_a_slice_moves_it_and_shows_everything_again(page):
    page.tab.locator("#surface [data-surface=points]").click()
    eventually(lambda: page.tab.evaluate("revisitPage.view().surfaces.children.length") == 8)
    page.tab.keyboard.press("c")
    low = page.tab.get_by_label("Lowest height that is shown")
    assert page.tab.evaluate("document.activeElement.id") == "slice-low"
    ends = float(low.get_attribute("min")), float(low.get_attribute("max"))
    assert -9.0 <= ends[0] <= -5.0 and 4.0 <= ends[1] <= 9.0
    assert low.get_attribute("aria-valuetext") == "lowest" and page.data("slice") == ""
    page.tab.keyboard.press("ArrowRight")
    assert page.data("slice") == f"from {ends[0] + 0.1:.1f} m".replace("-", "−")
    page.tab.keyboard.press("Tab")
    page.tab.keyboard.press("Home")
    page.tab.keyboard.press("ArrowRight")
    thin = f"to {ends[0] + 0.3:.1f} m".replace("-", "−")
    assert page.data("slice") == thin, "a handle takes the other one along"
    assert thin in page.tab.locator("#caption").inner_text()
    page.tab.keyboard.press("Tab")
    page.tab.keyboard.press("Enter")
    moved = f"from {ends[0] + 0.5:.1f} m to {ends[0] + 0.8:.1f} m".replace("-", "−")
    assert page.data("slice") == moved
    page.tab.keyboard.press("Escape")
    assert page.data("slice") == "" and not page.tab.locator("#slice").is_visible()
    assert page.tab.evaluate("revisitPage.view().planes.length") == 0
    page.tab.keyboard.press("c")
    assert page.data("slice") == moved, "it is kept while the map is the same"


def test_a_lifted_drawing_has_no_slice(page):
    page.tab.locator("#slice-on").click()
    page.tab.locator("#slice-high").fill("0")
    page.tab.locator("#lift").fill("50")
    assert page.data("slice") == "" and page.tab.locator("#slice-on").get_attribute("aria-pressed") == "false"
    page.tab.locator("#slice-on").click()
    assert page.tab.locator("#lift").input_value() == "0" and page.data("slice") == "to 0.0 m"


def test_a_finger_moves_a_handle_on_a_phone(chromium, service):
    shown = Page(chromium, service.http, "/#maps/town", **PHONE)
    shown.drawn()
    shown.tab.locator("#slice-on").tap()
    box = shown.tab.locator("#slice-high").bounding_box()
    shown.tab.touchscreen.tap(box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"])
    eventually(lambda: shown.data("slice").startswith("to "))
    assert shown.tab.evaluate("document.documentElement.scrollWidth") == 390
    assert shown.complaints == []
    shown.tab.close()


def by_hand(service):
    with Client(service.http) as client:
        return [loop for loop in client.loop_closures(TOWN, state="ALL") if loop.manual]


def numbers(fresh) -> list[float]:
    """x, y and z in metres, and the turn in degrees, as the fresh tells them."""
    return [float(fresh.tab.locator(f"#hand-{name}").input_value()) for name in ("x", "y", "z", "turn")]


def clouds_are_there(fresh):
    fresh.tab.wait_for_function("revisitPage.pair.match.children.length === 1 && revisitPage.pair.hand.isOn")


def test_two_submaps_are_picked_one_is_moved_by_keys_and_numbers_and_registered_from_there(fresh, service):
    fresh.tab.locator("[data-tool=join]").click()
    for submap in ("m4", "m0"):
        fresh.tab.mouse.click(*fresh.where(f"{TOWN}/sessions/monday/submaps/{submap}"))
    fresh.tab.get_by_role("button", name="Move by hand").click()
    clouds_are_there(fresh)
    start = numbers(fresh)
    assert start == pytest.approx([48.0, 8.0 * np.sin(4), 0.0, 0.0], abs=0.01), "as the map has them"
    for key in ("ArrowLeft", "Shift+ArrowLeft", "ArrowUp", "PageUp", ",", ","):
        fresh.tab.keyboard.press(key)
    assert np.subtract(numbers(fresh), start) == pytest.approx([-1.1, 0.1, 0.1, 2.0], abs=0.011)
    fresh.tab.get_by_label("Along x, metres").fill("0.4")
    fresh.tab.get_by_label("Along y, metres").fill("-0.3")
    fresh.tab.get_by_role("button", name="1 m, 10°").click()
    fresh.tab.get_by_role("button", name="Turned: more").click()
    fresh.tab.get_by_role("button", name="Height: less").click()
    put = numbers(fresh)
    assert put == pytest.approx([0.4, -0.3, -0.9, 12.0], abs=0.011)
    fresh.tab.locator("#evidence").get_by_label("Why").fill("the same gate")
    fresh.tab.get_by_role("button", name="Register from here").click()
    lies = fresh.tab.get_by_text("Pose of the query in the frame of the match")
    lies.wait_for()
    assert lies.inner_text().endswith("1 cm away from where it was put by hand."), "the fake leaves it there"
    assert fresh.tab.locator("#pair-verdict").inner_text().startswith("Accepted")
    assert "of the surface lies on the other one" in fresh.tab.locator("#evidence").inner_text()
    (loop,) = by_hand(service)
    assert (loop.query[-2:], loop.match[-2:], loop.state) == ("m4", "m0", "ACCEPTED")
    wanted = se3.from_yaw(np.radians(put[3]), put[:3])
    np.testing.assert_allclose(loop.T_match_query, wanted, rtol=0, atol=0.01)
    with Client(service.http) as client:
        first = client.loop_closure_events(loop)[0]
    assert (first.note, first.details["start"]) == ("the same gate", "by hand")
    fresh.tab.get_by_text("proposed by anyone, from where it was put by hand").wait_for()
    fresh.tab.locator("#by-hand").click()
    clouds_are_there(fresh)
    fresh.tab.get_by_role("button", name="Register from here").click()
    fresh.tab.get_by_text("joins the two submaps already").wait_for()
    assert fresh.complaints == [said for said in fresh.complaints if "409" in said], "the refusal alone"


def test_a_submap_of_a_session_that_is_not_drawn_is_picked_from_a_list(chromium, service):
    with Client(service.http) as client:
        client.create_map("apart")
        for session_id, place in (("monday", 10), ("tuesday", 200)):
            session = client.create_session("maps/apart", session_id)
            client.wait(client.post_submap(session, "gate", cloud_points(place), np.eye(4), 1))
        shown = Page(chromium, service.http, "/#maps/apart", viewport={"width": 390, "height": 844})
        shown.drawn()
        assert "1 session not drawn" in shown.tab.locator("#caption").inner_text()
        shown.tab.locator("[data-tool=join]").click()
        shown.tab.mouse.click(*shown.where("maps/apart/sessions/monday/submaps/gate"))
        listed = shown.tab.get_by_label("A submap that is not drawn")
        box = listed.bounding_box()
        assert box["x"] >= 8 and box["x"] + box["width"] <= 382, "inside the window"
        listed.select_option("tuesday / gate")
        assert not shown.tab.locator("#as-drawn").count(), "there is no drawing to begin with"
        shown.tab.get_by_role("button", name="Join them").click()
        shown.tab.locator("#told").wait_for(state="hidden")
        (loop,) = [one for one in client.loop_closures("maps/apart", state="ALL") if one.manual]
        assert (loop.query.split("/")[3], loop.match.split("/")[3]) == ("monday", "tuesday")
    assert shown.complaints == []
    shown.tab.close()


def test_of_loops_that_were_never_accepted_the_newest_is_listed_first(fresh):
    fresh.tab.locator("#loops > li").first.wait_for()
    names = fresh.tab.evaluate("""() => {
        const loops = [...revisitPage.model.loops.values()];
        loops.forEach((loop, row) => Object.assign(loop, { number: "0", created_at_ns: `1795879081617${row}85425` }));
        revisitPage.render();
        return loops.filter(({ state }) => state === "ACCEPTED").map(({ name }) => name);
    }""")
    listed = [row.get_attribute("data-name") for row in fresh.tab.locator("#loops > li").all()]
    assert listed == names[::-1]


def test_a_cloud_is_dragged_over_the_plane_and_a_rejected_registration_is_accepted_by_a_person(fresh, service):
    fresh.tab.keyboard.press("3")
    fresh.tab.locator("#loops button", has_text="Rejected").first.click()
    fresh.tab.locator("#pair[open]").wait_for()
    fresh.tab.keyboard.press("h")
    clouds_are_there(fresh)
    fresh.tab.wait_for_function("revisitPage.pair.due === 0")
    start, looks_from = numbers(fresh), "revisitPage.pair.camera.position.toArray()"
    camera = fresh.tab.evaluate(looks_from)
    box = fresh.tab.locator("#pair-view").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    fresh.tab.mouse.move(x, y)
    fresh.tab.mouse.down()
    fresh.tab.mouse.move(x + 40, y + 20, steps=4)
    fresh.tab.mouse.move(x + 80, y, steps=4)
    fresh.tab.mouse.up()
    moved = np.subtract(numbers(fresh), start)
    assert moved[0] > 2.0 and moved[1:] == pytest.approx([0.0, 0.0, 0.0], abs=0.02)
    assert fresh.tab.evaluate(looks_from) == camera, "the view stays where it is"
    fresh.tab.get_by_role("button", name="Register from here").click()
    fresh.tab.locator("#pair-verdict", has_text=re.compile("^Rejected: too little overlap")).wait_for()
    name = fresh.data("selected")
    assert name.startswith(f"{TOWN}/loopClosures/manual-")
    fresh.tab.get_by_role("button", name="Accept", exact=True).click()
    fresh.tab.locator("#pair-verdict", has_text=re.compile("^Accepted")).wait_for()
    eventually(lambda: [loop.state for loop in by_hand(service) if loop.name == name] == ["ACCEPTED"])
    assert fresh.complaints == []


@pytest.mark.slow
def test_one_finger_moves_the_cloud_and_two_move_the_view(chromium, service):
    shown = Page(chromium, service.http, f"/#{TOWN}", **PHONE)
    shown.drawn()
    shown.tab.locator("#loops button").last.click()
    shown.tab.locator("#by-hand").click()
    clouds_are_there(shown)
    touch, box = shown.tab.context.new_cdp_session(shown.tab), shown.tab.locator("#pair-view").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2

    def drag(*fingers):
        """Each finger goes from x to another place in four steps."""
        for step in range(5):
            points = [{"x": at + step * way / 4, "y": y, "id": n} for n, (at, way) in enumerate(fingers)]
            touch.send(
                "Input.dispatchTouchEvent", {"type": "touchMove" if step else "touchStart", "touchPoints": points}
            )
        touch.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})

    start, height = numbers(shown), "revisitPage.pair.camera.position.z"
    above = shown.tab.evaluate(height)
    drag((x, 60))
    moved = numbers(shown)
    assert moved[0] > start[0] + 1.0 and moved[1:] == pytest.approx(start[1:], abs=0.02)
    assert shown.tab.evaluate(height) == above
    drag((x - 20, -40), (x + 20, 40))
    assert numbers(shown) == moved and shown.tab.evaluate(height) < 0.9 * above
    assert shown.complaints == []
    shown.tab.close()


def test_escape_leaves_the_cloud_and_then_the_pair_and_the_other_keys_wait(fresh):
    fresh.tab.locator("#loops button").last.click()  # the oldest: no test has made it by hand
    fresh.tab.wait_for_function("revisitPage.pair.query.children.length === 1 && revisitPage.pair.share === 1")
    title = fresh.tab.locator("#pair-title").inner_text()
    fresh.tab.locator("#by-hand").click()
    clouds_are_there(fresh)
    fresh.tab.get_by_role("slider", name="Turned, degrees").fill("90")
    fresh.tab.get_by_role("button", name="Start again").click()
    assert numbers(fresh) == pytest.approx([1.0, 0.0, 0.0, 0.0], abs=0.01)
    fresh.tab.locator("#pair-view").focus()
    for key in ("j", "b", "v"):
        fresh.tab.keyboard.press(key)
    assert fresh.tab.locator("#pair-title").inner_text() == title and fresh.tab.evaluate("revisitPage.pair.hand.isOn")
    fresh.tab.keyboard.press("Escape")
    assert fresh.tab.locator("#pair").is_visible() and not fresh.tab.evaluate("revisitPage.pair.hand.isOn")
    assert "Both submaps show the same place." in fresh.tab.locator("#evidence").inner_text()
    fresh.tab.keyboard.press("Escape")
    assert not fresh.tab.locator("#pair").is_visible()
    assert fresh.complaints == []
