"""One picture through the kernels: forward, and backward from what forward left in its workspace."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from streamlod.core.arrays import Bool, Float32, Int32, Int64
from streamlod.core.camera import Camera
from streamlod.core.render.cpu.kernels.backward import differentiate_tiles
from streamlod.core.render.cpu.kernels.forward import blend_tiles
from streamlod.core.render.cpu.kernels.inline.constants import SUMS, TILE_PIXELS
from streamlod.core.render.cpu.kernels.project_backward import differentiate_projection
from streamlod.core.render.cpu.listing import MAX_PAIRS, list_gaussians, pack_camera, projected, reaching, share_tiles
from streamlod.core.render.cpu.workspace import Workspace
from streamlod.core.render.tiles import tile_grid
from streamlod.core.scene.gaussians import GaussianCloud


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """A rendered picture and what its backward pass needs; arrays belong to the workspace unless said otherwise.

    Attributes:
        image: [H,W,3] float32, own memory. transmittance: [H,W] float32, own memory.
        camera: [16] float32, see `pack_camera`.
        layers: [L,1024] what is blended already (`core.render.cpu.kernels.layers`); the first L ranks.
        visible: [V] int32 ascending rows of the Gaussians in view, own memory.
        rows: [M] int32 those that reach a tile to be drawn, own memory.
        order: by depth rank, index into `rows`; beyond its end for Gaussians that never want gradients.
        records: [N,16] by row; sorted_records: [...,16] by depth rank.
        tiles, bounds: tiles rendered, and each worker's share of them. offsets, lists: the tile lists.
    """

    image: Float32
    transmittance: Float32
    camera: Float32
    layers: Float32
    visible: Int32
    rows: Int32
    order: Int32
    records: Float32
    sorted_records: Float32
    tiles: Int32
    bounds: Int64
    offsets: Int64
    lists: Int32


@dataclass(frozen=True, slots=True, eq=False)
class Gradients:
    """dL by each parameter, shapes as in GaussianCloud, zero where a Gaussian is not visible or wants none.

    Attributes:
        rows: [G] int32 rows that were drawn among those that want gradients.
        screen: [G,2] dL by their projected means, in pixels.
    """

    means: Float32
    quaternions: Float32
    scales: Float32
    opacities: Float32
    colours: Float32
    rows: Int32
    screen: Float32


def forward(
    workspace: Workspace,
    cloud: GaussianCloud,
    camera: Camera,
    background: Float32,
    tile_mask: Bool | None = None,
    most_pairs: int = MAX_PAIRS,
) -> Frame:
    """Render `cloud`.

    Args:
        background: [3] float32.
        tile_mask: [tiles_y,tiles_x] bool, tiles to render; all by default. The others are black.
        most_pairs: of a Gaussian and a tile.

    Raises:
        InputError: the camera has lens distortion.
        ModelError: the Gaussians are so large that their tile lists would not fit.
    """
    seen = projected(workspace, cloud, camera)
    visible = np.flatnonzero(seen.depths > 0).astype(np.int32)
    rows = visible if tile_mask is None else reaching(seen, tile_mask)
    tiles_y, tiles_x = tile_grid(camera.width, camera.height)
    mask = np.ones(tiles_y * tiles_x, np.uint8) if tile_mask is None else tile_mask.astype(np.uint8).ravel()
    listing = list_gaussians(workspace, seen, rows, camera, mask, most_pairs=most_pairs)
    tiles, bounds = share_tiles(mask, np.diff(listing.offsets))
    size = camera.height, camera.width
    image, transmittance = np.empty((*size, 3), np.float32), np.empty(size, np.float32)
    if tile_mask is not None:
        image[:], transmittance[:] = 0, 1
    return blend(
        Frame(
            image=image,
            transmittance=transmittance,
            camera=pack_camera(camera),
            layers=np.empty((0, 4 * TILE_PIXELS), np.float32),
            visible=visible,
            rows=rows,
            order=listing.order,
            records=listing.records,
            sorted_records=listing.sorted_records,
            tiles=tiles,
            bounds=bounds,
            offsets=listing.offsets,
            lists=listing.lists,
        ),
        background,
    )


def blend(frame: Frame, background: Float32) -> Frame:
    """`frame` itself, its tiles drawn."""
    tiles_x = tile_grid(*frame.transmittance.shape[::-1])[1]
    lists = (frame.layers, frame.sorted_records, frame.offsets, frame.lists)
    blend_tiles(frame.tiles, frame.bounds, tiles_x, *lists, background, frame.image, frame.transmittance)
    return frame


def backward(
    workspace: Workspace,
    frame: Frame,
    cloud: GaussianCloud,
    image_gradient: Float32,
    light_gradient: Float32 | None = None,
    gradient_rows: int | None = None,
) -> Gradients:
    """Gradients of a loss, given its gradients by the picture.

    Args:
        image_gradient: [H,W,3] float32. light_gradient: [H,W] float32 by the transmittance; zero by default.
        gradient_rows: only the first rows of the cloud want gradients; all by default.
    """
    height, width = frame.transmittance.shape
    workers, count = len(frame.bounds) - 1, len(cloud)
    wanted = frame.rows if gradient_rows is None else frame.rows[: np.searchsorted(frame.rows, gradient_rows)]
    sums = workspace.take("sums", (workers, len(wanted), SUMS), np.float32)
    light = np.zeros((0, 0), np.float32) if light_gradient is None else light_gradient
    tiles_x = tile_grid(width, height)[1]
    out = Gradients(
        means=np.zeros((count, 3), np.float32),
        quaternions=np.zeros((count, 4), np.float32),
        scales=np.zeros((count, 3), np.float32),
        opacities=np.zeros(count, np.float32),
        colours=np.zeros((count, 3), np.float32),
        rows=wanted,
        screen=np.zeros((len(wanted), 2), np.float32),
    )
    if len(wanted):
        lists = (frame.layers, frame.sorted_records, frame.order, frame.offsets, frame.lists)
        picture = (frame.image, frame.transmittance, image_gradient, light)
        differentiate_tiles(frame.tiles, frame.bounds, tiles_x, *lists, *picture, sums)
        parameters = (cloud.means, cloud.quaternions, cloud.scales, frame.camera, width, height)
        into = (out.means, out.quaternions, out.scales, out.opacities, out.colours, out.screen)
        differentiate_projection(workers, wanted, frame.records, sums, *parameters, *into)
    return out


def contiguous(cloud: GaussianCloud) -> GaussianCloud:
    """The same cloud in C-contiguous arrays, as kernels need it; without a copy where it is so already."""
    names = ("means", "quaternions", "scales", "opacities", "colours")
    return GaussianCloud(*(np.ascontiguousarray(getattr(cloud, name)) for name in names))
