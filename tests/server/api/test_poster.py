"""What other sites get of a stream: its picture and a frame for their pages; a page where there is nothing."""

from __future__ import annotations

import html
import io
import re
from collections.abc import Iterator
from urllib.parse import parse_qs, urlencode, urlsplit

import httpx
import numpy as np
import pytest
from PIL import Image

from streamlod.core.render.splatter import Splatter
from streamlod.core.scene.anchors import Scene
from streamlod.server.api.poster import PREVIEW_SIZE, camera_of
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import Settings
from tests.client.web.miniserver import make_clip
from tests.client.web.scenes import make_scene
from tests.server.conftest import running


@pytest.fixture(scope="module")
def scene() -> Scene:
    return make_scene(300)


@pytest.fixture(scope="module")
def client(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Iterator[httpx.Client]:
    recording = tmp_path_factory.mktemp("poster") / "clip.slod"
    clip = make_clip(scene, 6)
    clip.write(recording)
    played, idle = StreamSpec(play=recording, loop=False), StreamSpec(id="idle", play=recording, loop=False)
    with running(Settings(), played, idle) as server:
        server.wait(lambda stream: stream["state"] == "ended", seconds=200)
        with server.client() as client:
            yield client


def test_the_poster_is_what_the_middle_camera_sees(client: httpx.Client, scene: Scene) -> None:
    answer = client.get("/v1/streams/main/poster.jpg")
    assert answer.headers["content-type"] == "image/jpeg"
    seen = np.asarray(Image.open(io.BytesIO(answer.content)), np.float64)
    newest = make_clip(scene, 6).states[5]
    expected = Splatter().picture(newest, scene.header.cameras[2])
    assert _psnr(seen, expected) > 30
    again = client.get("/v1/streams/main/poster.jpg", headers={"If-None-Match": answer.headers["etag"]})
    assert again.status_code == 304
    assert client.get("/v1/streams/none/poster.jpg").status_code == 404


VIEW = "0.5,-0.4,-2.6,-0.19,0.15,0.97,0.03,0.99,-0.15,2.6,1.25,0,0,1"


def test_a_link_shows_its_view_and_moment(client: httpx.Client, scene: Scene) -> None:
    """Both in the preview's picture and in oEmbed's; another moment is another picture; nonsense is refused."""
    address = f"{client.base_url}/?{urlencode({'stream': 'main', 'camera': VIEW, 't': 1, 'token': 'secret'})}"
    page = client.get(address).text
    found = html.unescape(re.search('og:image" content="(.+?)"', page)[1])  # type: ignore[index]
    assert 'og:title" content="main: ' in page
    assert "secret" not in page
    seen = np.asarray(Image.open(io.BytesIO(client.get(found).content)), np.float64)
    camera = camera_of(VIEW)
    assert camera is not None
    states = make_clip(scene, 6).states
    early, late = (_psnr(seen, Splatter().picture(states[number], camera)) for number in (1, 5))
    assert early > 30
    assert early > late + 1
    told = client.get("/oembed", params={"url": address}).json()
    assert client.get(told["thumbnail_url"]).content == client.get(found).content
    assert (told["thumbnail_width"], told["thumbnail_height"]) == PREVIEW_SIZE
    for query, status in (
        ({"camera": "1,2"}, 422), ({"camera": VIEW.replace("0.5", "nan", 1)}, 422), ({"t": 6}, 404),
        ({"t": 1, "epoch": 9}, 404), ({"t": -1}, 422), ({"camera": ",".join(["0"] * 14)}, 422),
    ):  # fmt: skip
        assert client.get("/v1/streams/main/poster.jpg", params=query).status_code == status, query


def _psnr(seen: np.ndarray, expected: np.ndarray) -> float:
    """In decibels, of pictures in [0, 255]."""
    return float(-10 * np.log10(np.mean((seen - np.asarray(expected, np.float64)) ** 2) / 255**2))


def test_other_sites_learn_how_to_show_the_page(client: httpx.Client) -> None:
    """From the page's Link header to a frame of the size asked for, and to a picture that is there."""
    address = f"{client.base_url}/?stream=main&camera=1,2&token=secret"
    page = client.get(address, headers={"Sec-Fetch-Dest": "document"})
    found = re.search('<(.+?)>; rel="alternate"', page.headers["link"])
    assert found
    answer = client.get(found[1], params={**parse_qs(urlsplit(found[1]).query), "maxwidth": 320}).json()
    assert (answer["version"], answer["type"], answer["width"], answer["height"]) == ("1.0", "rich", 320, 180)
    frame = re.search('src="(.+?)"', answer["html"])
    assert frame
    assert "stream=main&amp;camera=1%2C2&amp;embed=1" in frame[1]
    assert "secret" not in answer["html"]
    picture = Image.open(io.BytesIO(client.get(answer["thumbnail_url"]).content))
    assert picture.size == (answer["thumbnail_width"], answer["thumbnail_height"])
    for wrong in ("http://elsewhere.example/?stream=main", f"{client.base_url}/?stream=none", "http://[", "x"):
        refused = client.get("/oembed", params={"url": wrong})
        assert (refused.status_code in (404, 422), refused.headers["content-type"]) == (
            True,
            "application/problem+json",
        )


def test_makers_of_previews_find_the_picture_in_the_page(client: httpx.Client) -> None:
    """What no browser asks for has og:image; a browser gets the page without it."""
    preview = client.get('/?stream=main"<script>').text
    assert client.get(re.search('og:image" content="(.+?)"', client.get("/").text)[1]).status_code == 200  # type: ignore[index]
    assert "main%22%3Cscript%3E/poster.jpg" in preview
    assert "og:image" not in client.get("/", headers={"Sec-Fetch-Dest": "iframe"}).text


def test_nothing_there_is_said_to_people_and_to_programs(client: httpx.Client) -> None:
    """An unknown path answers a page to who asks for one, and a problem to all others."""
    asked = client.get("/no/<b>such</b>", headers={"Accept": "text/html,*/*;q=0.8"})
    assert (asked.status_code, asked.headers["content-type"]) == (404, "text/html; charset=utf-8")
    assert "/no/&lt;b&gt;such&lt;/b&gt;" in asked.text
    assert 'href="/"' in asked.text
    for path, accept in (("/no/such", "*/*"), ("/v1/streams/none", "text/html")):
        answer = client.get(path, headers={"Accept": accept})
        assert (answer.status_code, answer.headers["content-type"]) == (404, "application/problem+json")
        assert answer.json()["detail"].startswith("there is no")
