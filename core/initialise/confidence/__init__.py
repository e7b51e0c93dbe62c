"""How likely the depth of a pixel is right: the evidence for it, a network over the evidence, where it is asked."""
