"""The machine-readable description: what FastAPI finds, and what it cannot know."""

from __future__ import annotations

from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi

from streamlod.server.http.problems import PROBLEM_TYPE, ProblemBody

_OPEN_PATHS = {"/healthz", "/readyz"}  # need no token
_BEARER = {"type": "http", "scheme": "bearer", "description": "a token of the token file, or a JSON web token"}
_LINK = {"type": "apiKey", "in": "query", "name": "signature", "description": "of a signed link, with its other fields"}


def describe(app: FastAPI, *, needs_tokens: bool) -> dict[str, Any]:
    """The OpenAPI document, made once; its operations ask for a token where the server does."""
    if app.openapi_schema is None:
        document = get_openapi(title=app.title, version=app.version, description=app.description, routes=app.routes)
        components = document.setdefault("components", {})
        schemas = components.setdefault("schemas", {})
        schemas["ProblemBody"] = ProblemBody.model_json_schema()
        components["securitySchemes"] = {"token": _BEARER, "link": _LINK}
        for path, operations in document["paths"].items():
            for operation in operations.values():
                _complete(path, operation, needs_tokens)
        for name in ("HTTPValidationError", "ValidationError"):  # FastAPI's own, which is never sent
            schemas.pop(name, None)
        app.openapi_schema = document
    return app.openapi_schema


def _complete(path: str, operation: dict[str, Any], needs_tokens: bool) -> None:
    """Add the security of an operation, and problems in place of FastAPI's validation errors."""
    if needs_tokens and path not in _OPEN_PATHS:
        link: list[dict[str, list[str]]] = [{"link": []}] if "downloads" in operation.get("tags", ()) else []
        operation["security"] = [{"token": []}, *link]
    for status, answer in operation["responses"].items():
        if int(status) >= 400 and "application/json" in answer.get("content", {}) and status != "503":
            answer["content"] = {PROBLEM_TYPE: {"schema": {"$ref": "#/components/schemas/ProblemBody"}}}
