"""This server: version, limits and capabilities."""

from __future__ import annotations

import time

from fastapi import APIRouter, Request

from streamlod.core.version import streamlod_version
from streamlod.server.api.access import need, registry_of
from streamlod.server.api.schemas import Capabilities, ServerBody
from streamlod.server.auth.gate import Right
from streamlod.server.http.problems import problems
from streamlod.server.protocol.messages import PROTOCOL_VERSION

_ANSWERS = problems(401, 403, 429)
router = APIRouter(tags=["server"], responses=_ANSWERS, dependencies=[need(Right.READ)])


@router.get("/v1/server", summary="What the server is and can do")
async def get_server(request: Request) -> ServerBody:
    """Version, limits and capabilities."""
    registry = registry_of(request)
    settings = registry.settings
    return ServerBody(
        version=streamlod_version(),
        protocol_versions=[PROTOCOL_VERSION],
        started_at=registry.started_at,
        server_time_ns=time.time_ns(),
        limits=settings.limits.model_dump(),
        retention=settings.retention.model_dump(),
        capabilities=Capabilities(
            recording=registry.store is not None,
            tokens=settings.has_tokens,
            thin_viewers=settings.limits.thin_viewers > 0,
            webhooks=bool(settings.webhooks),
            stopping=registry.draining,
        ),
        edges=list(registry.edges),
    )
