"""Everything that streamlod raises on purpose.

    StreamlodError
    +-- InputError            a file, a folder, a picture or an option is not usable
    |   +-- StorageError      the disk is full, or does not take what is to be stored
    |   +-- StreamGoneError   the stream was deleted meanwhile
    +-- BitstreamError        bytes that are not a valid packet or file (refusal codes in codec/FORMAT.md)
    +-- SessionError          a peer broke the viewer protocol
    +-- RequestRefused        a server refuses a REST request
    +-- TrainingCutShort      training ended before the clip did; the frames before are in the file
    +-- FilmCutShort          a stream could not be watched to its end; the pictures before are in the film
    +-- ModelError            training or a scene reached a state from which it can't go on
    +-- BackendUnavailable    a rendering backend or an optional package is missing

Each carries the facts as fields and writes one sentence: what was wrong, and what to do.
"""

from __future__ import annotations

from collections.abc import Iterable


class StreamlodError(Exception):
    """Base of the tree; catch it to catch everything that streamlod refuses."""


class InputError(StreamlodError):
    """Input from outside cannot be used.

    Args:
        subject: the file, folder, camera or option at fault, as the user named it.
        fault: what is wrong with it and, where possible, what to do.
    """

    def __init__(self, subject: object, fault: str) -> None:
        super().__init__(subject, fault)
        self.subject = str(subject)
        self.fault = fault

    def __str__(self) -> str:
        return f"{self.subject}: {self.fault}"


def unknown_name(kind: str, name: str, known: Iterable[str]) -> InputError:
    """The error for a part of the method, of this `kind`, that a configuration names and that is not `known`."""
    return InputError(f"{kind} {name!r}", f"unknown; choose one of {', '.join(known)}")


class StorageError(InputError):
    """The disk is full, or does not take what is to be stored; nothing was stored."""


class StreamGoneError(InputError):
    """The request is about a stream that was deleted; another one may have its id."""


class BitstreamError(StreamlodError):
    """Bytes are refused.

    Args:
        code: the refusal code of FORMAT.md, for example ``truncated`` or ``bad_checksum``.
        detail: one sentence for people.
    """

    def __init__(self, code: str, detail: str) -> None:
        super().__init__(code, detail)
        self.code = code
        self.detail = detail

    def __str__(self) -> str:
        return f"{self.detail} [{self.code}]"


class SessionError(StreamlodError):
    """A viewer session has to end: the peer broke the protocol, or the server refuses it.

    Args:
        close_code: websocket close code of docs/protocol.md.
        detail: one sentence, at most 120 bytes, sent as the close reason.
    """

    def __init__(self, close_code: int, detail: str) -> None:
        super().__init__(close_code, detail)
        self.close_code = close_code
        self.detail = detail

    def __str__(self) -> str:
        return f"{self.detail} [{self.close_code}]"


class RequestRefused(StreamlodError):
    """A server refuses a REST request.

    Args:
        status: HTTP status.
        detail: one sentence of the server.
    """

    def __init__(self, status: int, detail: str) -> None:
        super().__init__(status, detail)
        self.status = status
        self.detail = detail

    def __str__(self) -> str:
        return f"{self.detail} [{self.status}]"


class TrainingCutShort(StreamlodError):
    """Training ended before the clip did, and its file is whole up to there.

    Args:
        path: the file.
        reason: what ended the training.
        kept: number of frames in the file.
        wanted: number of frames that were to be trained, or None where the source has no end.
    """

    def __init__(self, path: object, reason: str, kept: int, wanted: int | None) -> None:
        super().__init__(path, reason, kept, wanted)
        self.path, self.reason, self.kept, self.wanted = str(path), reason, kept, wanted

    def __str__(self) -> str:
        first = f"the first {self.kept}" if self.wanted is None else f"the first {self.kept} of {self.wanted}"
        return f"{self.reason}; {self.path} holds {first} frames, later ones are left out"


class FilmCutShort(StreamlodError):
    """A stream cannot be watched any more, and the film of it is whole up to there.

    Args:
        path: the film, or the folder of its pictures.
        reason: what ended it.
        kept: number of pictures.
    """

    def __init__(self, path: object, reason: str, kept: int) -> None:
        super().__init__(path, reason, kept)
        self.path, self.reason, self.kept = str(path), reason, kept

    def __str__(self) -> str:
        return f"{self.reason}; {self.path} holds what was seen before, {self.kept} pictures"


class ModelError(StreamlodError):
    """Training cannot go on, for example because no point is visible."""


class BackendUnavailable(StreamlodError):
    """A backend or optional package is missing.

    Args:
        name: the backend or package.
        remedy: what to install or choose instead.
    """

    def __init__(self, name: str, remedy: str) -> None:
        super().__init__(name, remedy)
        self.name = name
        self.remedy = remedy

    def __str__(self) -> str:
        return f"{self.name} is not available here; {self.remedy}"
