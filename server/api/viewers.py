"""Viewers of a stream: who they are, and sending one away."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Path, Request

from streamlod.core.close_codes import CloseCode
from streamlod.core.errors import SessionError
from streamlod.server.api.access import StreamOf, need, registry_of
from streamlod.server.api.schemas import ViewerBody, ViewerList
from streamlod.server.auth.gate import Right
from streamlod.server.http.problems import Problem, problems

_ANSWERS = problems(401, 403, 404, 422, 429)
router = APIRouter(
    prefix="/v1/streams/{stream_id}/viewers", tags=["viewers"], responses=_ANSWERS, dependencies=[need(Right.CONTROL)]
)

ViewerId = Annotated[str, Path(pattern="^[0-9a-f]{12}$", description="of the list")]


@router.get("", summary="Who watches")
async def list_viewers(stream: StreamOf, request: Request) -> ViewerList:
    """The stream's viewers, those who came first at the top."""
    items = [
        ViewerBody.model_validate(session.describe() | {"address": address})
        for session, address in registry_of(request).sessions.items()
        if session.stream_id == stream.id
    ]
    return ViewerList(items=items)


@router.delete("/{viewer_id}", status_code=204, summary="Disconnect a viewer")
async def disconnect_viewer(stream: StreamOf, request: Request, viewer_id: ViewerId) -> None:
    """Close a viewer's connection with 1008. It can come back as long as it has a token that lets it."""
    for session in registry_of(request).sessions:
        if session.stream_id == stream.id and session.id == viewer_id:
            session.end(SessionError(CloseCode.POLICY, "disconnected by the operator"))
            return
    raise Problem(404, f"the stream has no viewer {viewer_id}")
