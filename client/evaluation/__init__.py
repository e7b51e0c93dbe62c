"""Measuring the method: ablations on held-out views, the price of speed and bytes, and motion against the truth.

`study` compares whole systems (`rows`); `tradeoff` sweeps one knob at a time (`design`) and draws the Pareto front.
Both stand on `footage` (a split of a recording), `systems` (train and measure one configuration) and `scores`.
Sizes of packets come in through a callback, since the codec stands above this package.
"""
