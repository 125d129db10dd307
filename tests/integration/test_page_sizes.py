"""The page on a phone, a tablet and a laptop: nothing is outside the window, nothing lies on what must be read."""

from __future__ import annotations

from itertools import combinations

import pytest

from revisit import Client
from tests.support.browser import Page
from tests.support.live_service import live_service
from tests.support.page_town import EACH_BY_ITSELF, fill
from tests.support.service_world import cloud_points, pose

PHONE, TABLET, LAPTOP = (390, 844), (820, 1180), (1440, 900)
TOUCHED = (PHONE, TABLET)
NARROWEST = (320, 568)

EVERY_BOX = """root => [...document.querySelectorAll(`${root} *`)].filter(part => part.checkVisibility())
  .map(part => [part.id || part.className || part.tagName, part.getBoundingClientRect()])
  .filter(([, box]) => box.width && box.height)
  .map(([name, { left, top, right, bottom }]) => [String(name), left, top, right, bottom])"""
CUT = "[...document.querySelectorAll('#loops .end')].filter(end => end.scrollWidth > end.clientWidth).length"


@pytest.fixture(scope="module")
def service():
    """A map of two sessions whose submaps have names as long as those of `revisit ingest`."""
    with live_service(pipeline=EACH_BY_ITSELF) as running, Client(running.http) as client:
        fill(client, "town-of-a-long-name", named="part-{index}35-{index}{index}66")
        yield running


@pytest.fixture(scope="module", params=[PHONE, TABLET, LAPTOP], ids=["phone", "tablet", "laptop"])
def opened(request, chromium, service):
    yield from opened_in(chromium, service, request.param)


@pytest.fixture
def page(opened):
    """One page for all tests, as it is when nothing is chosen."""
    yield opened
    opened.tab.evaluate("document.querySelectorAll('dialog').forEach(one => one.close())")
    opened.tab.evaluate("revisitPage.select(null)")


@pytest.fixture
def phone(chromium, service):
    yield from opened_in(chromium, service, PHONE)


def opened_in(chromium, service, size, path="/"):
    """The page in a window of this size, on a device with a touch screen where it is a small one."""
    held = {"is_mobile": size in TOUCHED, "has_touch": size in TOUCHED}
    shown = Page(chromium, service.http, path, viewport={"width": size[0], "height": size[1]}, **held)
    shown.drawn()
    yield shown
    shown.tab.close()


def outside(page, root="body"):
    """What of `root` lies to the left or right of the window."""
    width = page.tab.viewport_size["width"]
    return [box for box in page.tab.evaluate(EVERY_BOX, root) if box[1] < -1 or box[3] > width + 1]


def shown_outside(page, root="body"):
    """What of `root` lies to the left or right of the window, but for names that end in an ellipsis."""
    return [box for box in outside(page, root) if box[0] != "EM"]


def box_of(page, selector):
    """Left, top, right and bottom of one part of the page, pixels."""
    box = page.tab.locator(selector).bounding_box()
    return box["x"], box["y"], box["x"] + box["width"], box["y"] + box["height"]


def on_each_other(page, *selectors):
    """The pairs of parts that overlap."""
    boxes = {name: box_of(page, name) for name in selectors}
    return [
        (one, other)
        for one, other in combinations(selectors, 2)
        if min(boxes[one][2], boxes[other][2]) - max(boxes[one][0], boxes[other][0]) > 1
        and min(boxes[one][3], boxes[other][3]) - max(boxes[one][1], boxes[other][1]) > 1
    ]


def fits(page):
    """Whether the window shows the whole width of the page, at its own scale."""
    width = page.tab.viewport_size["width"]
    return page.tab.evaluate("[innerWidth, document.documentElement.scrollWidth]") == [width, width]


def choose_a_submap(page):
    page.tab.evaluate("revisitPage.select({ submap: [...revisitPage.model.submaps.keys()][0] })")
    page.tab.locator("#card").wait_for()


@pytest.mark.parametrize("size", [PHONE, TABLET, LAPTOP], ids=["phone", "tablet", "laptop"])
def test_tools_cover_no_submap_of_a_map_that_is_fitted_into_the_window(size, chromium, service):
    for page in opened_in(chromium, service, size):
        require_free(page)


def require_free(page):
    """That no tools lie on a submap of a tall drive, and that the room between them is used."""
    names = page.tab.evaluate("[...revisitPage.model.submaps.keys()]")
    page.tab.evaluate("""() => {
        const view = revisitPage.view();
        [...view.places.values()].forEach((place, row) => place.at.set(0, 40 * row, 0));
        view.fit("top");
    }""")
    covered = [box_of(page, ".stage > .tools"), box_of(page, ".stage > .foot")]
    spots = [page.where(name) for name in names]
    assert [(x, y) for x, y in spots for _, top, _, bottom in covered if top <= y <= bottom] == []
    left = covered[1][1] - covered[0][3]
    assert max(y for _, y in spots) - min(y for _, y in spots) > 0.6 * left


def test_the_page_is_as_wide_as_its_window(page):
    assert fits(page) and outside(page) == []


def test_the_page_fits_the_narrowest_phone_also_while_it_has_much_to_say(chromium, service):
    for page in opened_in(chromium, service, NARROWEST):
        page.tab.locator("#health").evaluate(
            "said => (said.textContent = 'the storage is nearly full; working on 1,234')"
        )
        assert fits(page) and outside(page) == []


def test_a_loop_closure_opens_inside_the_window(page):
    page.tab.locator("#loops button").first.click()
    page.tab.wait_for_function("revisitPage.pair.query.children.length === 1")
    left, top, right, bottom = box_of(page, "#pair")
    size = page.tab.viewport_size
    assert left >= 0 and top >= 0 and right <= size["width"] and bottom <= size["height"]
    assert fits(page) and outside(page, "#pair") == []


def test_what_is_drawn_of_a_loop_closure_is_not_covered_by_its_labels_and_tools(page):
    page.tab.locator("#loops button").first.click()
    page.tab.wait_for_function("revisitPage.pair.query.children.length === 1")
    assert on_each_other(page, ".pane-name.query", ".pane-name.match", ".pane-name.both", ".panes .tools") == []
    header = "#pair > header"
    assert on_each_other(page, f"{header} h2", f"{header} .steps", f"{header} .verdict") == []
    _, top, _, bottom = box_of(page, ".panes .tools")
    assert bottom - top <= 50


def test_a_cloud_is_moved_by_hand_inside_the_window_and_its_tools_lie_beside_each_other(page):
    page.tab.locator("#loops button").first.click()
    page.tab.locator("#by-hand").click()
    page.tab.wait_for_function("revisitPage.pair.match.children.length === 1 && revisitPage.pair.hand.isOn")
    assert fits(page) and outside(page, "#pair") == []
    assert on_each_other(page, ".pane-name.query", ".pane-name.match", ".panes .tools") == []
    assert box_of(page, "#hand-go")[3] <= box_of(page, "#pair")[3], "it is there without scrolling"


def test_the_handles_of_a_slice_lie_beside_the_other_tools(page):
    page.tab.locator("#slice-on").click()
    assert fits(page) and outside(page, "#slice") == []
    assert on_each_other(page, "#slice", "#tools", "#caption", ".stage > .tools") == []
    assert box_of(page, "#slice")[3] - box_of(page, "#slice")[1] <= 90
    page.tab.locator("#slice-on").click()


def test_the_list_of_keys_opens_inside_the_window(page):
    page.tab.evaluate("document.getElementById('help').showModal()")
    left, top, right, bottom = box_of(page, "#help")
    size = page.tab.viewport_size
    assert left >= 0 and top >= 0 and right <= size["width"] and bottom <= size["height"]
    assert outside(page, "#help") == []


def test_a_chosen_submap_is_told_of_beside_the_tools(page):
    choose_a_submap(page)
    assert outside(page, "#card") == []
    assert on_each_other(page, "#camera", "#surface", ".lift:not(.colour-by, #time)", "#time", "#card") == []


def test_the_tools_leave_most_of_the_drawing_free(page):
    _, top, _, bottom = box_of(page, ".stage > .tools")
    assert bottom - top <= 90
    assert (
        on_each_other(
            page, "#camera", "#surface", ".lift:not(.colour-by, #time)", "#time", ".colour-by", "#caption", "#scale"
        )
        == []
    )


def test_both_ends_of_every_loop_closure_can_be_read_in_the_list(page):
    assert page.tab.locator("#loops .end").count() == 10
    assert page.tab.evaluate(CUT) == 0


@pytest.mark.parametrize("size", [pytest.param(PHONE, marks=pytest.mark.slow), LAPTOP], ids=["phone", "laptop"])
def test_names_of_the_greatest_length_cover_and_leave_nothing(size, chromium, service):
    with Client(service.http) as client:
        named = client.create_map("m" * 64, display_name="A hall of a name " * 15)
        for session_id in ("a" * 64, "b" * 64):
            session = client.create_session(named, session_id)
            client.wait(client.post_submap(session, "s" * 64, cloud_points(5), pose(0.0), 1))
    for page in opened_in(chromium, service, size, f"/#{named.name}"):
        assert on_each_other(page, ".pick", "#health", "#theme") == []
        assert size == PHONE or on_each_other(page, ".pick", "#figures", "#health") == []
        assert fits(page) and shown_outside(page) == []
        page.tab.locator("#loops button").first.click()
        page.tab.wait_for_function("revisitPage.pair.query.children.length === 1")
        assert fits(page) and shown_outside(page, "#pair") == []
        assert on_each_other(page, ".pane-name.query", ".pane-name.both") == []
        assert box_of(page, "#pair-close")[2] < box_of(page, "#pair")[2]


@pytest.mark.slow
def test_a_finger_chooses_the_submap_that_it_touches_and_nothing_that_appears_under_it(phone):
    phone.tab.add_style_tag(content="#card { inset: 0 } #card button { position: fixed; inset: 0 }")
    submap = phone.tab.evaluate("[...revisitPage.model.submaps.keys()][3]")
    phone.tab.touchscreen.tap(*phone.where(submap))
    phone.until("selected", submap)
    assert not phone.tab.locator("#pair").is_visible() and phone.tab.locator("#card").is_visible()


@pytest.mark.slow
def test_with_a_finger_one_session_can_be_shown_alone(phone):
    phone.tab.locator("#sessions .only").first.tap()
    phone.until("drawn-submaps", 5)
