"""Live free-viewpoint video: level-of-detail Gaussian splatting, trained frame by frame and streamed.

The code stands in the folders `core`, `codec`, `client` and `server` of the repository; this package joins them under
one name, by links in a checkout and by copies in a wheel.
"""
