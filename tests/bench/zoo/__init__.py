"""The zoo: scenes that differ in every way, from few views, ours against plain Gaussians at equal CPU time."""
