"""Procedural textures: the colour of a surface point from its place on its part.

Detail finer than a pixel's footprint is faded out, so that what two cameras see of one spot agrees. In the textures,
`u` and `v` are metres on a surface, `x`, `y` and `z` metres in the part's own axes, `f` metres that a sample covers.
"""
