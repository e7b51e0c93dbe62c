"""Phones that film in a browser: real pages with Chromium's fake camera, into a real server and a real rig.

The stream's worker is left out: the rig takes pictures at the stream's socket in this process, so nothing trains.
"""

from __future__ import annotations

import json
import re
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from streamlod.codec.sound.packets import write_packets
from streamlod.core.calibration.walk import open_walk
from streamlod.server.auth.gate import hash_token
from streamlod.server.cli.rig import find, watch
from streamlod.server.ingest.poses import PoseWatch
from streamlod.server.settings import Settings, load_settings
from tests.client.web.conftest import TEST_FLAGS, Console, chromium_path
from tests.client.web.test_accessible import AXE, RULES
from tests.client.web.watching import WAIT
from tests.core.data.writers import write_video
from tests.opus import read_sound
from tests.server.conftest import running
from tests.server.ingest.push.stage import FPS, HEIGHT, WIDTH, Stage, rig, stage

pytestmark = pytest.mark.browser

CAMERA_FLAGS = [
    *("--use-fake-device-for-media-stream=device-count=1,fps=20", "--use-fake-ui-for-media-stream"),
    "--disable-renderer-backgrounding",
]


@pytest.fixture(scope="module")
def phone(chromium: Any) -> Iterator[Any]:
    """A Chromium with a fake camera that asks nobody; beside the package's, as Playwright runs once."""
    browser = chromium.browser_type.launch(executable_path=chromium_path(), args=[*TEST_FLAGS, *CAMERA_FLAGS])
    yield browser
    browser.close()


@contextmanager
def opened(phone: Any, address: str, **options: Any) -> Iterator[Any]:
    """A page of its own at an address; its console stays empty."""
    context = phone.new_context(viewport={"width": 400, "height": 700}, reduced_motion="reduce", **options)
    page = context.new_page()
    page.set_default_timeout(WAIT["timeout"])
    page.complaints = Console(page)
    page.goto(address)
    yield page
    context.close()
    page.complaints.forgive("WebSocket connection")  # the browser's remark on connections that fail
    assert page.complaints.lines == []


def says(page: Any, text: str) -> None:
    """Wait until the page's state is that sentence, or part of it."""
    page.wait_for_function("(text) => document.getElementById('status-text').textContent.includes(text)", arg=text)


def figure(page: Any, name: str) -> str:
    """A figure that the page shows; the table is drawn anew each second, at first a second after the page."""
    shown = page.wait_for_function(
        "(name) => [...document.querySelectorAll('#figures dt')].find((term) => term.textContent === name)"
        "?.nextSibling.textContent",
        arg=name,
    )
    return str(shown.json_value())


@contextmanager
def filmed(phone: Any, instants: int) -> Iterator[tuple[Stage, Any]]:
    """A page that films for a stream, which has got so many instants."""
    with stage(Settings(), rig((WIDTH, HEIGHT), 1)) as found, opened(phone, found.page()) as page:
        says(page, "Ready to film")
        page.click("#film")
        found.wait(instants)
        yield found, page


@pytest.mark.parametrize("codec", ["h264", "jpeg"])
def test_two_phones_film_one_scene_in_step(phone: Any, codec: str) -> None:
    """Pictures of both are paired by the times that they state, which are those of this machine's clock."""
    with (
        stage(Settings(), rig((WIDTH, HEIGHT), 2, quorum=2)) as found,
        opened(phone, found.page(f"&codec={codec}")) as one,
    ):
        says(one, "Ready to film")
        one.click("#film")
        says(one, "Filming as phone1")
        with opened(phone, found.page(f"&codec={codec}")) as two:
            says(two, "Ready to film")
            two.wait_for_function("document.getElementById('name').value === 'phone2'")  # the other name is in use
            two.click("#film")
            says(two, "Filming as phone2")
            frames = found.wait(20)
            one.wait_for_function("document.querySelector('#figures dd')?.textContent.includes('320')")
            assert figure(one, "Picture").endswith("H.264" if codec == "h264" else "JPEG")
            assert figure(one, "Refused") == "0"
    for frame in frames:
        assert frame.present.all()
        assert 0 < frame.latency_ns < 5_000_000_000
        assert abs(frame.time_ns - time.time_ns()) < 60_000_000_000
        for image in frame.images:
            assert image.shape == (HEIGHT, WIDTH, 3)
            red, green, blue = np.median(image.reshape(-1, 3), 0)  # the fake camera's background
            assert green > 1.5 * max(red, blue)
    first, second = (np.stack([frame.images[row] for frame in frames]).astype(int) for row in range(2))
    together, later, earlier = first[1:-1] - second[1:-1], first[1:-1] - second[2:], first[1:-1] - second[:-2]
    # both see the same moving scene; by the whole of it, as a busy browser stamps single pictures late
    assert np.abs(together).mean() < min(np.abs(later).mean(), np.abs(earlier).mean())


@pytest.mark.parametrize("codec", ["opus", "pcm"])
def test_a_phone_whose_sound_is_wanted_sends_it(phone: Any, codec: str, tmp_path: Path) -> None:
    """The fake microphone beeps; other phones are asked for no sound."""
    definition = rig((WIDTH, HEIGHT), 2, sound="phone1")
    with (
        stage(Settings(), definition) as found,
        opened(phone, found.page(f"&camera=phone2&sound={codec}")) as silent,
        opened(phone, found.page(f"&camera=phone1&sound={codec}")) as page,
    ):
        for each in (silent, page):
            says(each, "Ready to film")
            each.click("#film")
            says(each, "Filming as phone")
        limit = time.monotonic() + 60
        while not found.heard or found.heard[-1].end_ns - found.heard[0].begin_ns < 2e9:
            assert time.monotonic() < limit, found.dataset.statistics()
            time.sleep(0.05)
        pieces, now_ns = list(found.heard), time.time_ns()
        page.wait_for_function("document.querySelector('#figures dd') !== null")
        assert figure(page, "Sound") == ("Opus" if codec == "opus" else "samples")
        assert figure(silent, "Sound") == "none"
        assert figure(page, "Refused") == "0"
        statistics = found.dataset.statistics()
    assert statistics is not None
    assert statistics.sound == ""
    assert 0 < now_ns - pieces[-1].end_ns < 5e9
    write_packets(tmp_path / "heard.opus", pieces[0].settings, [p for piece in pieces for p in piece.packets])
    samples = np.concatenate(list(read_sound(tmp_path / "heard.opus")))
    loud = np.abs(samples.astype(int)).max(axis=1) > 1000
    assert 0.01 < loud.mean() < 0.7, "beeps, and silence between them"


def test_a_phone_whose_sound_is_refused_films_on(phone: Any) -> None:
    """Sound that comes too late, as of a phone that was busy, while its pictures come seldom."""
    with stage(Settings(), rig((WIDTH, HEIGHT), 1, sound="phone1")) as found, opened(phone, "about:blank") as page:
        page.add_init_script(
            "const settings = MediaStreamTrack.prototype.getSettings;"
            "MediaStreamTrack.prototype.getSettings = function () {"
            "  return this.kind === 'audio' ? { latency: 20 } : settings.call(this);"
            "};"
        )
        page.goto(found.page())
        says(page, "Ready to film")
        page.click("#film")
        says(page, "Filming as phone1")
        found.wait(3)
        page.evaluate("document.getElementById('picture').pause()")
        says(page, "The camera gives no pictures")
        assert re.fullmatch(r"\d{2,}: sent sound 2\d s too late, of which 5 s are allowed", figure(page, "Refused"))
        page.evaluate("document.getElementById('picture').play()")
        says(page, "Filming as phone1")
        found.wait(5)


def test_a_phone_without_a_microphone_films_on(phone: Any) -> None:
    with stage(Settings(), rig((WIDTH, HEIGHT), 1, sound="phone1")) as found, opened(phone, "about:blank") as page:
        page.add_init_script(
            "const ask = navigator.mediaDevices.getUserMedia.bind(navigator.mediaDevices);"
            "navigator.mediaDevices.getUserMedia = async (wanted) => {"
            "  if (wanted.audio) throw new DOMException('denied', 'NotAllowedError');"
            "  return ask(wanted);"
            "};"
        )
        page.goto(found.page())
        says(page, "Ready to film")
        page.click("#film")
        says(page, "Filming as phone1")
        page.get_by_text("No sound is sent: there is no microphone, or the page may not use it. Allow it in").wait_for()
        assert len(found.wait(5)) == 5


def test_the_page_says_how_it_films_and_what_it_cannot_hold(phone: Any) -> None:
    """Size, rate, clock; the fake camera lets exposure and focus be held, but no white balance."""
    with stage(Settings(), rig((WIDTH, HEIGHT), 1)) as found, opened(phone, found.page()) as page:
        says(page, "Ready to film")
        if AXE.exists():
            page.add_script_tag(path=AXE)
            assert page.evaluate(RULES, None) == []
        page.click("#film")
        page.wait_for_selector("#notes li:has-text('does not hold: white balance.')")
        page.wait_for_function("document.querySelector('#figures')?.textContent.includes('240, H.264')")
        assert figure(page, "Sent").endswith("Mbit/s")
        ahead, error = re.fullmatch(r"server's (\S+) ms (?:ahead|behind), to (\S+) ms", figure(page, "Clock")).groups()  # type: ignore[union-attr]
        assert float(ahead) <= float(error) + 50  # one machine, one clock; the page's own runs on from when it began
        if AXE.exists():
            assert page.evaluate(RULES, None) == []
        page.click("#hold")
        page.wait_for_function("document.getElementById('hold').ariaPressed === 'false'")
        page.wait_for_function("!document.querySelector('#notes').textContent.includes('hold')")
        page.click("#film")
        says(page, "Ready to film")


def test_a_slow_server_gets_newer_pictures_rather_than_older_ones(phone: Any) -> None:
    """While nothing is taken, pictures are left out; later ones come as quickly as before."""
    with filmed(phone, 5) as (found, page):
        page.wait_for_selector("#figures dd")
        before = int(figure(page, "Left out"))
        assert found.dataset.rig is not None
        with found.dataset.rig._change:  # where pictures are put
            page.wait_for_function(
                "(least) => [...document.querySelectorAll('#figures dt')].some("
                "(name) => name.textContent === 'Left out' && +name.nextSibling.textContent >= least)",
                arg=before + 20,
            )
            page.wait_for_selector("#notes li:has-text('too slow')")
        late = found.wait(15)[-5:]
        assert all(frame.latency_ns < 1_500_000_000 for frame in late)
        assert found.dataset.statistics() is not None
        page.wait_for_function("!document.querySelector('#notes').textContent.includes('too slow')")


def test_filming_goes_on_after_the_stream_was_away(phone: Any) -> None:
    """The connection is made anew, and H.264 begins with a picture that needs none before it."""
    with filmed(phone, 5) as (found, page):
        found.dataset.close()
        says(page, "Trying again: the stream takes no pictures at present")
        with found.filming():
            says(page, "Filming as phone1")
            found.wait(10)
            assert figure(page, "Refused") == "0"


def test_a_phone_films_under_a_name_also_where_its_page_was_opened_before_the_stream(phone: Any) -> None:
    with stage(Settings(), rig((WIDTH, HEIGHT), 1)) as found:
        found.dataset.close()
        with opened(phone, found.page()) as page:
            says(page, "Trying again: the stream takes no pictures at present")
            assert page.is_disabled("#film"), "it would film as nobody"
            with found.filming():
                says(page, "Ready to film")
                page.click("#film")
                says(page, "Filming as phone1")
                found.wait(2)


def test_who_takes_a_name_that_is_in_use_gets_it_and_the_other_is_told(phone: Any) -> None:
    """Also of the camera whose sound is wanted; who lost it can take it back once it is free."""
    with stage(Settings(), rig((WIDTH, HEIGHT), 1, sound="phone1")) as found, opened(phone, found.page()) as one:
        says(one, "Ready to film")
        one.click("#film")
        says(one, "Filming as phone1")
        found.wait(3)
        with opened(phone, found.page("&camera=phone1")) as two:
            two.wait_for_function("document.querySelector('#name option')?.textContent === 'phone1 (in use)'")
            two.click("#film")
            says(two, "Filming as phone1")
            says(one, "The server refuses phone1: it is sent by another phone or capture node now. If this is phone1, ")
            found.wait(5)
            two.click("#film")
            says(two, "Ready to film")
            one.wait_for_function("document.querySelector('#name option')?.textContent === 'phone1'")
            one.click("#film")
            says(one, "Filming as phone1")
            found.wait(20)
            says(one, "Filming as phone1")


def test_a_phone_whose_name_was_taken_keeps_it_rather_than_film_as_a_camera_elsewhere(phone: Any) -> None:
    """A name stands for a place: pressed once more, Film is not to send this phone's pictures as the other's."""
    with (
        stage(Settings(), rig((WIDTH, HEIGHT), 2)) as found,
        opened(phone, found.page("&camera=phone1")) as one,
        opened(phone, found.page("&camera=phone1")) as two,
    ):
        for page in (one, two):
            says(page, "Ready to film")
            page.click("#film")
            says(page, "Filming as phone1")
            found.wait(2)
        says(one, "If this is phone1, press Stop there and Film here; else choose another name.")
        assert one.input_value("#name") == "phone1"
        assert one.eval_on_selector("#name", "(list) => list.selectedOptions[0].text") == "phone1 (in use)"


def test_a_phone_tells_who_holds_it_what_is_wrong_with_its_place_or_name(
    phone: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(PoseWatch, "look", lambda *_: None)  # it finds nothing in Chromium's pictures
    with stage(Settings(), rig((WIDTH, HEIGHT), 12)) as found, opened(phone, found.page("&camera=phone1")) as page:
        says(page, "Ready to film")
        page.click("#film")
        says(page, "Filming as phone1.")
        found.wait(1)
        assert found.dataset.rig is not None
        for faults, sentence in (
            (("phone11 and phone12 are exchanged",), "Filming as phone1."),
            (("phone2 was knocked", "phone1 and phone4 are exchanged"), "but phone1 and phone4 are exchanged."),
            (("no camera's pose holds",), "Filming as phone1, but no camera's pose holds."),
            ((), "Filming as phone1."),
        ):
            found.dataset.rig.note_poses(faults)
            says(page, sentence)


def test_a_phone_that_has_just_begun_is_not_called_slow(phone: Any) -> None:
    """Its first second begins before it films."""
    with stage(Settings(), rig((WIDTH, HEIGHT), 1)) as found, opened(phone, "about:blank") as page:
        page.add_init_script("window.ticks = []; window.setInterval = (act) => ticks.push(act);")
        page.goto(found.page())
        says(page, "Ready to film")
        page.evaluate("() => ticks.forEach((act) => act())")
        page.wait_for_timeout(1000)
        page.click("#film")
        says(page, "Filming as phone1")
        found.wait(1)
        page.evaluate("() => ticks.forEach((act) => act())")
        assert "pictures" not in page.text_content("#notes")


SLOW_ENCODER = """
const ask = VideoEncoder.isConfigSupported.bind(VideoEncoder);
const allowed = new Promise((resolve) => (window.allow = resolve));
VideoEncoder.isConfigSupported = (config) => allowed.then(() => ask(config));
"""


def test_two_phones_that_are_offered_one_name_at_once_film_under_two(phone: Any) -> None:
    """Both ask before either has sent a picture; who loses the name takes a free one by itself."""
    with (
        stage(Settings(), rig((WIDTH, HEIGHT), 2, quorum=2)) as found,
        opened(phone, "about:blank") as one,
        opened(phone, "about:blank") as two,
    ):
        for page in (one, two):
            page.add_init_script(SLOW_ENCODER)
            page.goto(found.page())
            says(page, "Ready to film")
            page.click("#film")
            says(page, "Filming as phone1")
        for page in (one, two):
            page.evaluate("window.allow()")
            page.wait_for_function("document.querySelector('#figures')?.textContent.includes('H.264')")
        assert all(frame.present.all() for frame in found.wait(10))
        assert {each.input_value("#name") for each in (one, two)} == {"phone1", "phone2"}


def test_a_name_that_was_taken_while_the_browser_asked_for_the_camera_is_left_to_the_other(phone: Any) -> None:
    with stage(Settings(), rig((WIDTH, HEIGHT), 2)) as found, opened(phone, "about:blank") as slow:
        slow.add_init_script(
            "const ask = navigator.mediaDevices.getUserMedia.bind(navigator.mediaDevices);"
            "const allowed = new Promise((resolve) => (window.allow = resolve));"
            "navigator.mediaDevices.getUserMedia = (wanted) => allowed.then(() => ask(wanted));"
        )
        slow.goto(found.page())
        says(slow, "Ready to film")
        slow.click("#film")
        with opened(phone, found.page()) as quick:
            says(quick, "Ready to film")
            quick.click("#film")
            says(quick, "Filming as phone1")
            found.wait(1)
            slow.evaluate("window.allow()")
            says(slow, "Filming as phone2")
            delivered = [frame.present[0] for frame in found.wait(10)]
            assert sum(delivered) > 5, "on a busy machine a picture may be late"
            says(quick, "Filming as phone1")
            assert [page.input_value("#name") for page in (quick, slow)] == ["phone1", "phone2"]


def test_a_page_that_is_loaded_again_is_the_same_camera(phone: Any) -> None:
    """Its name is kept in its address, so that two phones that sleep do not come back with each other's pose."""
    with stage(Settings(), rig((WIDTH, HEIGHT), 2)) as found, opened(phone, found.page()) as page:
        says(page, "Ready to film")
        page.select_option("#name", "phone2")
        page.click("#film")
        says(page, "Filming as phone2")
        page.reload()
        says(page, "Ready to film")
        assert page.eval_on_selector("#device", "(list) => list.selectedOptions[0]?.text") == "rear camera"
        page.click("#film")
        says(page, "Filming as phone2")


def test_a_phone_whose_page_is_opened_anew_is_offered_the_name_that_it_had(phone: Any) -> None:
    """As after its battery was empty: the QR code holds no name, and the first free one may be another phone's."""
    with stage(Settings(), rig((WIDTH, HEIGHT), 3)) as found, opened(phone, found.page()) as page:
        says(page, "Ready to film")
        page.select_option("#name", "phone2")
        page.click("#film")
        says(page, "Filming as phone2")
        found.wait(2)
        page.goto(found.page())
        says(page, "Ready to film")
        page.wait_for_function("document.getElementById('name').value === 'phone2'")
        with opened(phone, found.page()) as other:
            says(other, "Ready to film")
            assert other.input_value("#name") == "phone1"


HIDDEN = """(hidden) => {
  Object.defineProperty(document, "hidden", { value: hidden, configurable: true });
  document.dispatchEvent(new Event("visibilitychange"));
}"""


def test_filming_goes_on_by_itself_after_the_screen_was_locked(phone: Any) -> None:
    """Browsers pause the picture or take the camera away; who takes it while the page is seen keeps it."""
    with filmed(phone, 3) as (found, page):
        page.evaluate(HIDDEN, True)
        page.evaluate("document.getElementById('picture').pause()")
        says(page, "The camera gives no pictures")
        page.evaluate(HIDDEN, False)
        says(page, "Filming as phone1")
        found.wait(3)
        end = "document.getElementById('picture').srcObject.getTracks()[0].dispatchEvent(new Event('ended'))"
        page.evaluate(HIDDEN, True)
        page.evaluate(end)
        says(page, "The camera was taken away")
        page.evaluate(HIDDEN, False)
        says(page, "Filming as phone1")
        found.wait(3)
        page.evaluate(end)
        says(page, "The camera was taken away")
        page.evaluate(HIDDEN, True)
        page.evaluate(HIDDEN, False)
        says(page, "The camera was taken away")


NEXT_FIGURES = """() => new Promise((resolve) => {
  const figures = document.getElementById("figures");
  new MutationObserver(() => resolve(figures.innerText)).observe(figures, { childList: true });
})"""


def test_pictures_a_second_are_counted_while_the_page_is_seen(phone: Any) -> None:
    """A hidden page films little or nothing: it said that the camera gives too few pictures, or none are sent."""
    with filmed(phone, 3) as (_, page):
        assert "Mbit/s" in page.evaluate(NEXT_FIGURES) + page.evaluate(NEXT_FIGURES)
        page.evaluate(HIDDEN, True)
        page.evaluate("document.getElementById('picture').pause()")
        says(page, "The camera gives no pictures")
        page.evaluate(HIDDEN, False)
        assert "not known yet" in page.evaluate(NEXT_FIGURES)
        assert "Mbit/s" in page.evaluate(NEXT_FIGURES)


TURNED = """
const canvas = document.createElement("canvas"), pen = canvas.getContext("2d");
window.turn = (width, height) => Object.assign(canvas, { width, height });
setInterval(() => { pen.fillStyle = `rgb(0 ${Date.now() % 200} 0)`; pen.fillRect(0, 0, 999, 999); }, 40);
navigator.mediaDevices.getUserMedia = async () => canvas.captureStream(25);
"""


def test_a_phone_that_is_turned_while_it_films_goes_on_when_it_is_turned_back(phone: Any) -> None:
    with stage(Settings(), rig((WIDTH, HEIGHT), 1)) as found, opened(phone, "about:blank") as page:
        page.add_init_script(TURNED)
        page.goto(found.page())
        page.evaluate(f"turn({WIDTH}, {HEIGHT})")
        says(page, "Ready to film")
        page.click("#film")
        says(page, "Filming as phone1")
        found.wait(3)
        page.evaluate(f"turn({HEIGHT}, {WIDTH})")
        says(page, "Turn the phone")
        page.evaluate(f"turn({WIDTH}, {HEIGHT})")
        says(page, "Filming as phone1")
        found.wait(3)
        assert figure(page, "Refused") == "0"


def test_a_camera_that_gives_nothing_any_more_is_told_of(phone: Any) -> None:
    """As of a phone whose screen is locked."""
    with filmed(phone, 3) as (_, page):
        page.evaluate("document.getElementById('picture').srcObject.getTracks()[0].stop()")
        says(page, "The camera gives no pictures")


@pytest.mark.parametrize(
    ("query", "sentence"),
    [
        ("?stream=main", "does not take pictures from here: a valid token is needed."),
        ("?stream=main&token=reader", "does not take pictures from here: the token does not give the right to publish"),
        ("?stream=other&token=nodes", "does not take pictures from here: there is no such stream."),
    ],
)
def test_who_may_not_film_is_told_why(phone: Any, tmp_path: Path, query: str, sentence: str) -> None:
    with stage(guarded(tmp_path), rig((WIDTH, HEIGHT), 2), "all") as found:
        with opened(phone, f"{found.server.url}/capture{query}") as page:
            says(page, sentence)
            assert page.is_disabled("#film")
        assert found.got == []


def test_a_phone_whose_token_runs_out_stops_its_camera(
    phone: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It says what to do, and does not try again, as each attempt would count against its address."""
    monkeypatch.setattr("streamlod.server.api.access.RECHECK_SECONDS", 0.2)
    with (
        stage(guarded(tmp_path), rig((WIDTH, HEIGHT), 1), "all") as found,
        opened(phone, found.page("&token=nodes")) as page,
    ):
        says(page, "Ready to film")
        page.click("#film")
        found.wait(3)
        (tmp_path / "tokens.json").write_text("[]")
        found.server.registry.gate.reload()
        says(page, "the token has expired or was withdrawn; connect with another. Open this page by a link with")
        page.wait_for_function("document.getElementById('picture').srcObject.getTracks()[0].readyState === 'ended'")
        assert page.is_disabled("#film")
        assert not page.is_visible("#picture")
        assert found.server.registry.gate.refused == 0


def test_a_link_is_good_for_one_camera(phone: Any, tmp_path: Path) -> None:
    """It needs no token, and offers no other name."""
    with stage(guarded(tmp_path), rig((WIDTH, HEIGHT), 2), "all") as found:
        with found.server.client(headers={"Authorization": "Bearer all"}) as client:
            link = client.post("/v1/streams/main/links", json={"path": "ingest/phone2"}).json()["url"]
        with opened(phone, found.server.url + link) as page:
            says(page, "Ready to film")
            assert page.eval_on_selector_all("#name option", "(all) => all.map((e) => e.value)") == ["phone2"]
            page.click("#film")
            assert [list(frame.present) for frame in found.wait(3)] == [[False, True]] * 3


def guarded(folder: Path) -> Settings:
    """Settings with tokens: one for everything, one that reads, one of capture nodes."""
    rights = {"all": ["read", "publish", "control"], "reader": ["read"], "nodes": ["publish"]}
    file = folder / "tokens.json"
    entries = [
        {"name": name, "sha256": hash_token(name), "rights": given, "streams": "*"} for name, given in rights.items()
    ]
    file.write_text(json.dumps(entries))
    return Settings(tokens=file)


def test_a_page_without_https_says_so(chromium: Any) -> None:
    """Elsewhere than on the server's own machine."""
    flags = [*TEST_FLAGS, *CAMERA_FLAGS, "--host-resolver-rules=MAP stage.test 127.0.0.1"]
    browser = chromium.browser_type.launch(executable_path=chromium_path(), args=flags)
    settings = Settings(hosts=("stage.test",))
    with running(settings) as server, opened(browser, f"http://stage.test:{server.port}/capture") as page:
        says(page, f"pages with https in their address: open https://stage.test:{server.port}/capture")
        assert not page.is_visible("#film")
    browser.close()


def test_an_upright_phone_films_upright_pictures(chromium: Any, tmp_path: Path) -> None:
    """A camera that gives upright pictures; where the stream wants them across, the page says so."""
    clip = tmp_path / "upright.y4m"
    with clip.open("wb") as file:
        file.write(f"YUV4MPEG2 W{HEIGHT} H{WIDTH} F{FPS}:1 Ip A1:1 C420mpeg2\n".encode())
        luma = np.repeat(np.linspace(40, 220, WIDTH), HEIGHT).astype(np.uint8)  # darker above
        for _ in range(FPS):
            file.write(b"FRAME\n" + luma.tobytes() + bytes([128]) * (WIDTH * HEIGHT // 2))
    flags = [*TEST_FLAGS, *CAMERA_FLAGS, f"--use-file-for-fake-video-capture={clip}"]
    browser = chromium.browser_type.launch(executable_path=chromium_path(), args=flags)
    with stage(Settings(), rig((HEIGHT, WIDTH), 1)) as found, opened(browser, found.page()) as page:
        says(page, "Ready to film")
        page.click("#film")
        image = found.wait(5)[-1].images[0]
        assert image.shape == (WIDTH, HEIGHT, 3)
        rows = image.mean((1, 2))
        assert abs(rows[20] - 40) < 25
        assert abs(rows[-20] - 225) < 25
    with stage(Settings(), rig((WIDTH, HEIGHT), 1)) as found, opened(browser, found.page()) as page:
        says(page, "Ready to film")
        page.click("#film")
        says(page, "Turn the phone")
        assert found.got == []
    browser.close()


def recorded(
    folder: Path, sources: list[str], size: tuple[int, int], seconds: float, sound: str | None = None
) -> tuple[str, threading.Thread]:
    """The address of a phone's page, and the thread in which `streamlod rig` records it beside `sources`."""
    file, said = folder / "rig.json", list[str]()
    find(sources, file, 1, size, FPS, said.append, sound=sound, overwrite=False)
    settings = load_settings(folder / "rig.toml").model_copy(update={"host": "127.0.0.1", "port": 0})
    recording = threading.Thread(
        target=lambda: watch(file, folder / "walk", seconds, settings, said.append, overwrite=False), daemon=True
    )
    recording.start()
    limit = time.monotonic() + 60
    while not (pages := [line.rpartition(" ")[2] for line in said if "each phone: https://" in line]):
        assert time.monotonic() < limit, said
        time.sleep(0.05)
    return pages[0], recording


def test_a_phone_is_recorded_over_https_before_anything_is_calibrated(phone: Any, tmp_path: Path) -> None:
    """`streamlod rig` makes the certificate, shows the page's address, and records what the phone films."""
    still = tmp_path / "still.mp4"
    write_video(still, [np.zeros((HEIGHT, WIDTH, 3), np.uint8)] * (60 * FPS), fps=FPS)
    address, recording = recorded(tmp_path, [str(still)], (WIDTH, HEIGHT), 3.0, sound="phone1")
    with opened(phone, address, ignore_https_errors=True) as page:
        says(page, "Ready to film")
        page.click("#film")
        says(page, "Filming as phone1")
        page.wait_for_function("document.querySelector('#figures').textContent.includes('Opus')")  # wanted once live
        recording.join(120)
        assert not recording.is_alive()
        says(page, "Trying again")
        page.complaints.forgive("ERR_CONNECTION")
    filmed = {each.camera: each for each in open_walk(tmp_path / "walk")}["phone1"]
    assert filmed.size == (WIDTH, HEIGHT)
    pictures = [picture for picture in filmed.pictures() if picture is not None]
    assert len(pictures) > FPS
    assert all(picture[..., 1].mean() > 1.5 * picture[..., 0].mean() for picture in pictures)  # the fake camera's green
    assert 0 <= filmed.times[0] < 1
    assert 2 < filmed.times[-1] < 3.2
