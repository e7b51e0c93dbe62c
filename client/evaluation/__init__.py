"""Measuring the method: ablations on held-out views, speed and bytes against quality, and motion against the truth.

`study` compares whole systems (`rows`); `tradeoff` varies one setting at a time (`design`) and draws the Pareto front.
Both use `footage` (a split of a recording), `systems` (train and measure one configuration) and `scores`.
`file_scores` measures a `.slod` file. All score pictures with `measure.scores` and count the bytes of real packets.
"""
