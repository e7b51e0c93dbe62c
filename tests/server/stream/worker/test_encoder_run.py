"""Epochs are numbered without gaps or repeats, and training continues only from what it can continue from."""

from __future__ import annotations

import pytest

from streamlod.server.protocol.packets import Position
from streamlod.server.stream.recording.stored_stream import StoredStream
from streamlod.server.stream.worker.encoder_run import EncoderRun


def test_epochs_follow_each_other() -> None:
    first = EncoderRun(epoch=6).begun()
    assert (first.epoch, first.next_epoch) == (7, 7)
    for over in (first.ended(), first.ended().ended(), first.anew()):
        assert (over.epoch, over.next_epoch, over.begun().epoch) == (7, 8, 8)


def test_frames_are_counted_until_the_source_begins_anew() -> None:
    run = EncoderRun(trained_from="a").begun().reported({"version": 0}).reported({"version": 1})
    assert (run.frames, run.ended().frames, run.anew().frames) == (2, 2, 0)
    assert run.reported({"version": 2, "done": 9}).frames == 9
    assert run.reported(None).frames == 0


def test_what_is_noted_is_found_again() -> None:
    """Previews and restarts make versions and frames differ; the note holds by how much."""
    run = EncoderRun(epoch=3, is_over=False, frames=5, trained_from="a")
    stored = StoredStream(epoch=3, **run.note(version=11))
    again = EncoderRun(epoch=3, trained_from="a")
    assert again.resumed(stored, Position(3, 11)).frames == 5
    assert again.resumed(stored, Position(3, 9)).frames == 3  # not all of it was recorded
    assert again.resumed(stored, Position(3, 2)).frames == 0


@pytest.mark.parametrize("run", [
    EncoderRun(frames=5),  # a file that is played
    EncoderRun(trained_from="a"),  # nothing is trained yet
])  # fmt: skip
def test_what_cannot_be_continued_is_noted_as_such(run: EncoderRun) -> None:
    assert run.note(7) == {"trained_from": ""}


@pytest.mark.parametrize("names", [("b", "a"), ("", ""), ("a", "")])
def test_a_recording_of_something_else_is_not_continued(names: tuple[str, str]) -> None:
    now, then = names
    run = EncoderRun(epoch=3, trained_from=now)
    assert run.resumed(StoredStream(epoch=3, trained_from=then), Position(3, 4)) == run


def test_an_epoch_whose_training_was_not_noted_is_not_continued() -> None:
    run = EncoderRun(epoch=4, trained_from="a")
    assert run.resumed(StoredStream(epoch=4, trained_from="a"), Position(3, 4)) == run
