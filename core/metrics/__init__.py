"""How far a picture is from the truth: PSNR and SSIM here, LPIPS in `core.metrics.lpips` (needs torch)."""

from streamlod.core.metrics.pictures import MAX_PSNR, Distance, psnr, ssim, ssim_map

__all__ = ["MAX_PSNR", "Distance", "psnr", "ssim", "ssim_map"]
