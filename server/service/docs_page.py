"""The page `/docs`: Swagger UI from an installed package, so that it needs no other site."""

from __future__ import annotations

import importlib.util
from pathlib import Path

from fastapi import FastAPI
from fastapi.openapi.docs import get_swagger_ui_html
from fastapi.responses import HTMLResponse
from fastapi.staticfiles import StaticFiles

_PACKAGE = "fastapi_swagger"
_FOLDER = "/docs/files"
_WITHOUT = f"<p><code>pip install {_PACKAGE}</code> shows this page; there is <a href=/openapi.json>/openapi.json</a>"


def add_docs(app: FastAPI) -> None:
    """Add the page, or a page that says what to install."""
    folder = _files()
    if folder is not None:
        app.mount(_FOLDER, StaticFiles(directory=folder), name="docs files")

    @app.get("/docs", include_in_schema=False)
    async def docs() -> HTMLResponse:
        if folder is None:
            return HTMLResponse(_WITHOUT)
        return get_swagger_ui_html(
            openapi_url="/openapi.json",
            title=app.title,
            swagger_js_url=f"{_FOLDER}/swagger-ui-bundle.js",
            swagger_css_url=f"{_FOLDER}/swagger-ui.css",
            swagger_favicon_url=f"{_FOLDER}/favicon-32x32.png",
        )


def _files() -> Path | None:
    """Swagger UI's files, found without importing their package."""
    package = importlib.util.find_spec(_PACKAGE)
    for place in (package.submodule_search_locations or []) if package else []:
        for path in sorted(Path(place).glob("**/swagger-ui-bundle.js")):
            return path.parent
    return None
