"""Published figures for comparison: quoted, not measured here, and from other hardware."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class Quoted:
    """A published row: LPIPS by VGG, megabytes and training seconds a frame, rendered frames a second."""

    views: int
    method: str
    psnr: float
    ssim: float | None
    lpips: float | None
    megabytes: float
    seconds: float
    fps: float


SOURCE = "StreamLoD-GS paper: 300 frames, one NVIDIA A800 80 GB, first points of all methods by VGGT"

_STREAMRF, _GSTREAM, _HICOM, _4DGC, _QUEEN = "StreamRF", "3DGStream", "HiCoM", "4DGC", "QUEEN"
_STAR, _PAPER = "StreamLoD-GS star", "StreamLoD-GS"

MEET_ROOM = (
    Quoted(3, _STREAMRF, 15.82, 0.641, 0.510, 22.81, 7.854, 14.9),
    Quoted(3, _GSTREAM, 17.24, 0.687, 0.481, 3.822, 5.526, 588),
    Quoted(3, _HICOM, 16.92, 0.665, 0.431, 0.913, 1.762, 517),
    Quoted(3, _4DGC, 17.36, 0.713, 0.416, 0.653, 17.41, 418),
    Quoted(3, _QUEEN, 17.01, 0.670, 0.443, 0.860, 0.455, 486),
    Quoted(3, _STAR, 18.50, 0.783, 0.400, 0.245, 0.643, 677),
    Quoted(3, _PAPER, 18.85, 0.793, 0.383, 0.253, 1.073, 547),
    Quoted(4, _STREAMRF, 16.75, 0.748, 0.452, 19.53, 8.210, 17.1),
    Quoted(4, _GSTREAM, 18.36, 0.797, 0.413, 3.850, 5.510, 609),
    Quoted(4, _HICOM, 18.58, 0.809, 0.391, 0.894, 2.012, 524),
    Quoted(4, _4DGC, 19.45, 0.810, 0.385, 0.794, 18.61, 441),
    Quoted(4, _QUEEN, 19.26, 0.753, 0.386, 0.823, 0.581, 484),
    Quoted(4, _STAR, 20.67, 0.823, 0.370, 0.209, 0.823, 689),
    Quoted(4, _PAPER, 21.40, 0.832, 0.351, 0.215, 1.581, 625),
    Quoted(5, _STREAMRF, 17.57, 0.780, 0.432, 16.46, 8.921, 19.3),
    Quoted(5, _GSTREAM, 19.53, 0.817, 0.400, 3.841, 5.440, 619),
    Quoted(5, _HICOM, 19.69, 0.826, 0.391, 0.819, 2.225, 518),
    Quoted(5, _4DGC, 21.28, 0.831, 0.380, 0.639, 19.52, 425),
    Quoted(5, _QUEEN, 21.22, 0.803, 0.343, 0.603, 0.692, 485),
    Quoted(5, _STAR, 21.95, 0.843, 0.343, 0.198, 0.973, 621),
    Quoted(5, _PAPER, 22.73, 0.861, 0.310, 0.205, 1.910, 608),
    Quoted(12, _GSTREAM, 26.36, None, None, 4.51, 4.95, 309),
    Quoted(12, _HICOM, 26.73, None, None, 0.60, 3.92, 289),
    Quoted(12, _4DGC, 26.87, None, None, 0.63, 21.3, 273),
    Quoted(12, _QUEEN, 27.35, None, None, 0.35, 1.31, 254),
    Quoted(12, _PAPER, 27.84, None, None, 0.19, 2.93, 312),
)
N3DV = (
    Quoted(3, _STREAMRF, 18.79, 0.732, 0.401, 41.23, 13.614, 19.5),
    Quoted(3, _GSTREAM, 19.89, 0.747, 0.373, 6.301, 9.162, 662),
    Quoted(3, _HICOM, 19.21, 0.741, 0.352, 1.201, 1.83, 512),
    Quoted(3, _4DGC, 19.82, 0.763, 0.339, 0.871, 17.49, 484),
    Quoted(3, _QUEEN, 19.25, 0.743, 0.330, 0.962, 0.452, 460),
    Quoted(3, _STAR, 20.50, 0.785, 0.320, 0.112, 0.793, 651),
    Quoted(3, _PAPER, 20.54, 0.790, 0.316, 0.126, 1.336, 530),
    Quoted(4, _STREAMRF, 19.08, 0.747, 0.390, 39.68, 16.46, 22.3),
    Quoted(4, _GSTREAM, 20.16, 0.780, 0.363, 6.610, 8.830, 687),
    Quoted(4, _HICOM, 19.81, 0.767, 0.326, 1.024, 2.36, 501),
    Quoted(4, _4DGC, 20.12, 0.779, 0.305, 0.837, 18.20, 478),
    Quoted(4, _QUEEN, 19.64, 0.773, 0.293, 0.710, 0.568, 482),
    Quoted(4, _STAR, 21.14, 0.812, 0.283, 0.243, 0.982, 679),
    Quoted(4, _PAPER, 21.30, 0.817, 0.280, 0.256, 1.696, 525),
    Quoted(6, _STREAMRF, 20.95, 0.762, 0.380, 12.78, 17.25, 26.1),
    Quoted(6, _GSTREAM, 21.85, 0.800, 0.351, 6.624, 8.965, 666),
    Quoted(6, _HICOM, 21.17, 0.812, 0.306, 0.847, 4.519, 499),
    Quoted(6, _4DGC, 22.54, 0.833, 0.298, 0.784, 19.07, 472),
    Quoted(6, _QUEEN, 22.88, 0.841, 0.289, 0.718, 0.816, 466),
    Quoted(6, _STAR, 23.36, 0.842, 0.271, 0.211, 1.401, 524),
    Quoted(6, _PAPER, 23.85, 0.852, 0.256, 0.223, 2.313, 506),
)
TABLES = {"Meet Room": MEET_ROOM, "N3DV": N3DV}


@dataclass(frozen=True, slots=True)
class QuotedAblation:
    """A published ablation on Meet Room; LPIPS only where it was given."""

    name: str
    psnr: float
    ssim: float | None
    lpips: float | None
    megabytes: float
    seconds: float
    fps: float


# The first four at 5 views (their caption says 3, but the full row is the 5-view one), the last three at 3.
ABLATIONS = (
    QuotedAblation("5 views, without quantisation", 22.51, 0.852, 0.320, 1.683, 1.673, 582),
    QuotedAblation("5 views, without the partition", 23.11, 0.857, 0.326, 0.283, 2.197, 425),
    QuotedAblation("5 views, without levels of detail", 20.02, 0.778, 0.337, 0.633, 0.902, 487),
    QuotedAblation("5 views, full", 22.73, 0.865, 0.310, 0.205, 1.910, 608),
    QuotedAblation("3 views, separate heads", 18.68, None, None, 0.290, 1.330, 425),
    QuotedAblation("3 views, without dropout", 17.99, None, None, 0.256, 1.096, 498),
    QuotedAblation("3 views, full", 18.85, None, None, 0.253, 1.073, 547),
)


@dataclass(frozen=True, slots=True)
class Peer:
    """A published row of a dense-view table: kilobytes and training seconds a frame, rendered frames a second."""

    method: str
    source: str
    psnr: float
    ssim: float | None
    kilobytes: float
    seconds: float | None
    fps: float


_QUARC, _COMGS = "QuARC-GS paper, RTX PRO 6000", "ComGS paper, A100"
PEERS_SOURCE = (
    "all training views, 300 frames, cam00 held out; N3DV at 1352x1014. Sizes are the authors' own, mostly Shannon "
    "estimates; 3DGStream and StreamRF with frame 0"
)
PEERS = {
    "N3DV, six scenes": (
        Peer(_STREAMRF, _QUARC, 30.68, 0.930, 31_500, 15, 10),
        Peer(_GSTREAM, _QUARC, 31.35, 0.948, 7_800, 8.1, 245),
        Peer(_GSTREAM, _COMGS, 31.67, None, 7_800, 8.5, 261),
        Peer(_GSTREAM, "its own paper, RTX 3090", 31.67, None, 7_800, 12, 215),
        Peer(_HICOM, _QUARC, 31.17, None, 900, 11, 260),
        Peer(_4DGC, _QUARC, 31.58, 0.943, 500, 50, 168),
        Peer("QUEEN-s", _COMGS, 31.89, None, 680, 4.65, 345),
        Peer("QUEEN-l", _QUARC, 32.19, 0.946, 750, 7.9, 248),
    ),
    "Meet Room, three scenes": (
        Peer(_STREAMRF, _COMGS, 26.72, None, 9_000, 10.2, 10),
        Peer(_GSTREAM, _QUARC, 29.30, 0.948, 4_100, 4.77, 260),
        Peer(_GSTREAM, _COMGS, 30.79, None, 4_100, 4.9, 350),
        Peer(_HICOM, _QUARC, 26.73, None, 600, 9.8, 258),
    ),
}


def quoted_json() -> dict[str, Any]:
    """All of it, for reports."""
    return {
        "source": SOURCE,
        "tables": {name: [asdict(row) for row in rows] for name, rows in TABLES.items()},
        "ablations": [asdict(row) for row in ABLATIONS],
        "peers_source": PEERS_SOURCE,
        "peers": {name: [asdict(row) for row in rows] for name, rows in PEERS.items()},
    }
