"""Error answers of the REST interface (RFC 9457)."""

from __future__ import annotations

import html
from typing import Any

from pydantic import BaseModel, ConfigDict, Field
from starlette.responses import HTMLResponse, JSONResponse

PROBLEM_TYPE = "application/problem+json"


class ProblemBody(BaseModel):
    """An error (RFC 9457)."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {"type": "about:blank", "title": "Not found", "status": 404, "detail": "there is no stream 'stage'"}
            ]
        }
    )

    type: str = Field(description="always about:blank: the status says what kind it is")
    title: str
    status: int
    detail: str = Field(description="one sentence")


class Problem(Exception):
    """An error answer.

    Args:
        status: HTTP status.
        detail: one sentence.
        headers: further headers.
    """

    def __init__(self, status: int, detail: str, headers: dict[str, str] | None = None) -> None:
        super().__init__(status, detail)
        self.status, self.detail, self.headers = status, detail, headers


TITLES = {
    400: "Bad request", 401: "Token missing or wrong", 403: "Not allowed", 404: "Not found", 405: "Method not allowed",
    409: "Conflict", 410: "Gone", 412: "Precondition failed", 415: "Unsupported media type",
    416: "Range not satisfiable", 421: "Misdirected request", 422: "Unusable content", 429: "Too many refusals",
    500: "Fault in the server", 502: "Origin lost", 503: "Not ready", 507: "Disk full",
}  # fmt: skip


_PROBLEMS: dict[int | str, dict[str, Any]] = {
    status: {"content": {PROBLEM_TYPE: {"schema": {"$ref": "#/components/schemas/ProblemBody"}}}, "description": text}
    for status, text in {
        400: "the body is no JSON", 401: "token missing or wrong", 403: "the token lacks the right",
        404: "not found", 405: "this address takes other methods", 409: "conflict",
        410: "it has left the window", 412: "the stream is not as `If-Match` expects",
        415: "the body is not of type application/json",
        416: "the range lies outside", 421: "the server does not answer to this name",
        422: "the request is malformed", 429: "too many wrong tokens", 502: "the origin does not answer",
        503: "the server is stopping", 507: "the disk is full",
    }.items()
}  # fmt: skip
_PROBLEMS[413] = {"description": "the body is too large; the connection ends"}  # before it is read: without a body


def problems(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """The answers of these statuses, as FastAPI describes them."""
    return {status: _PROBLEMS[status] for status in statuses}


_PAGE = """<!doctype html><html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<meta name="color-scheme" content="dark light"><title>{title}</title>
<style>body{{font:16px/1.5 system-ui;margin:20vh auto;padding:0 1em;max-width:26em;text-align:center}}</style>
<h1>{title}</h1><p>{detail}</p><p><a href="/">To the viewer</a></p></html>"""


def not_found_page(detail: str) -> HTMLResponse:
    """A 404 for people, who came here by a link that is wrong."""
    return HTMLResponse(_PAGE.format(title=TITLES[404], detail=html.escape(detail)), 404)


def problem_response(status: int, detail: str, headers: dict[str, str] | None = None) -> JSONResponse:
    """A problem as `application/problem+json`."""
    body = {"type": "about:blank", "title": TITLES.get(status, "Error"), "status": status, "detail": detail}
    return JSONResponse(body, status, headers, media_type=PROBLEM_TYPE)
