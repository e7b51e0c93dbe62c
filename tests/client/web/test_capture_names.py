"""Names under which phones film: offered, taken by another, kept."""

from __future__ import annotations

from typing import Any

import pytest

from streamlod.server.ingest.poses import PoseWatch
from streamlod.server.settings import Settings
from tests.client.web.phones import opened, says
from tests.server.ingest.push.stage import HEIGHT, WIDTH, rig, stage

pytestmark = pytest.mark.browser


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
        one.select_option("#name", "phone2")
        one.click("#film")
        says(one, "Filming as phone2")
        found.wait(2)
        one.evaluate("document.getElementById('figures').replaceChildren()")
        one.wait_for_function("document.getElementById('figures').textContent.includes('Refused0')")  # of this name


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
            found.dataset.rig.findings.note_poses(faults)
            says(page, sentence)


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
            delivered = found.wait(10)
            assert any(frame.present.all() for frame in delivered), "on a busy machine many a picture is late"
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
