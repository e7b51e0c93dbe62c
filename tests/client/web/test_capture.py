"""Phones that film in a browser: real pages with Chromium's fake camera, into a real server and a real rig.

The stream's worker is left out: the rig takes pictures at the stream's socket in this process, so nothing trains.
"""

from __future__ import annotations

import re
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from streamlod.codec.sound.packets import write_packets
from streamlod.core.calibration.walk import open_walk
from streamlod.server.settings import Settings
from tests.client.web.conftest import CAMERA_FLAGS, TEST_FLAGS, chromium_path
from tests.client.web.phones import figure, filmed, opened, recorded, says
from tests.client.web.test_accessible import AXE, RULES
from tests.core.data.writers import write_video
from tests.opus import read_sound
from tests.server.conftest import running
from tests.server.ingest.push.stage import FPS, HEIGHT, WIDTH, rig, stage

pytestmark = pytest.mark.browser


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


def test_a_microphone_that_is_taken_away_is_told_while_the_phone_films_on(phone: Any) -> None:
    with stage(Settings(), rig((WIDTH, HEIGHT), 1, sound="phone1")) as found, opened(phone, found.page()) as page:
        says(page, "Ready to film")
        page.click("#film")
        says(page, "Filming as phone1")
        page.wait_for_function("document.querySelector('#figures')?.textContent.includes('Opus')")
        page.evaluate(
            "document.getElementById('picture').srcObject.getAudioTracks()[0].dispatchEvent(new Event('ended'))"
        )
        page.get_by_text("No sound is sent any more: the microphone was taken away.").wait_for()
        count = len(found.got)
        found.wait(count + 5)
        page.click("#film")
        says(page, "Ready to film")
        page.click("#film")
        says(page, "Filming as phone1")
        page.wait_for_function("document.querySelector('#figures')?.textContent.includes('Opus')")
        assert page.get_by_text("taken away").count() == 0


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


def test_the_screen_is_kept_on_while_a_phone_films(phone: Any) -> None:
    with stage(Settings(), rig((WIDTH, HEIGHT), 1)) as found, opened(phone, "about:blank") as page:
        page.add_init_script(
            "window.locks = [];"
            "const request = async (kind) => (locks.push(kind), { release: () => locks.push('released') });"
            "Object.defineProperty(navigator, 'wakeLock', { value: { request } });"
        )
        page.goto(found.page())
        says(page, "Ready to film")
        assert page.evaluate("locks") == []
        page.click("#film")
        says(page, "Filming as phone1")
        page.wait_for_function("locks.join() === 'screen'")
        page.click("#film")
        says(page, "Ready to film")
        page.wait_for_function("locks.join() === 'screen,released'")


def test_who_holds_a_phone_whose_screen_may_go_off_is_told(phone: Any) -> None:
    with stage(Settings(), rig((WIDTH, HEIGHT), 1)) as found, opened(phone, "about:blank") as page:
        page.add_init_script("Object.defineProperty(navigator, 'wakeLock', { value: undefined });")
        page.goto(found.page())
        says(page, "Ready to film")
        page.click("#film")
        page.wait_for_selector("#notes li:has-text('Keep the screen on')")


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
