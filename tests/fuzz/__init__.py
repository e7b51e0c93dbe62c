"""Fuzz targets. `python -m tests.fuzz.run packet` fuzzes with atheris; the ordinary tests replay the corpus."""
