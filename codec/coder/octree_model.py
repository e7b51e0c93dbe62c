"""Octree occupancy, as compiled loops. FORMAT.md section 7."""

from __future__ import annotations

import numpy as np

from streamlod.codec.coder.compiled import compiled
from streamlod.codec.coder.rans import Array, begin, finish, put_flag, take_flag

OCTREE_MODELS = 16 * 256


@compiled
def _octree_model(depth: int, d: int, parent: int, prefix: int) -> int:
    """Index of the model of an occupancy bit at depth `d`, by its parent's class and the node's bits before it."""
    return ((min(depth - 1 - d, 3) * 4 + parent) << 8) | prefix


@compiled
def _parent_class(children: int) -> int:
    """Class of a node with so many children: 1, 2, 3 to 4, more."""
    return 0 if children <= 1 else 1 if children == 2 else 2 if children <= 4 else 3


@compiled
def octree_items(keys: Array, depth: int, items: Array, n: int) -> int:
    """Model pass over strictly ascending Morton `keys` of `depth` bits an axis."""
    models = np.ones((OCTREE_MODELS, 2), np.int64)
    parents = np.zeros(1, np.int64)
    for d in range(depth):
        shift = 3 * (depth - 1 - d)
        classes = np.zeros(len(keys), np.int64)
        i, node, born = 0, 0, 0
        while i < len(keys):
            occupancy, children = 0, 0
            parent_key = keys[i] >> (shift + 3)
            while i < len(keys) and keys[i] >> (shift + 3) == parent_key:
                child = (keys[i] >> shift) & 7
                if not occupancy >> child & 1:
                    occupancy |= 1 << child
                    children += 1
                i += 1
            prefix = 1
            for j in range(8):
                bit = occupancy >> j & 1
                if j < 7 or prefix != 1 << 7:
                    n = put_flag(items, n, models[_octree_model(depth, d, parents[node], prefix)], bit)
                prefix = 2 * prefix + bit
            for _ in range(children):
                classes[born] = _parent_class(children)
                born += 1
            node += 1
        parents = classes
    return n


@compiled
def decode_octree(words: Array, lanes: int, depth: int, count: int) -> tuple[bool, Array]:
    """(whether the stream is sound, [count,3] int64 nodes)."""
    x, ctl = np.zeros(lanes, np.int64), np.zeros(3, np.int64)
    models = np.ones((OCTREE_MODELS, 2), np.int64)
    nodes, parents = np.zeros((1, 3), np.int64), np.zeros(1, np.int64)
    begin(words, x, ctl)
    for d in range(depth):
        room = min(count, 8 * len(nodes))
        children, classes = np.zeros((room, 3), np.int64), np.zeros(room, np.int64)
        born = 0
        for node in range(len(nodes)):
            prefix, first = 1, born
            for j in range(8):
                bit = 1
                if j < 7 or prefix != 1 << 7:
                    bit = take_flag(words, x, ctl, models[_octree_model(depth, d, parents[node], prefix)])
                prefix = 2 * prefix + bit
                if bit:
                    if born == room:
                        ctl[2] = 1
                        break
                    children[born, 0] = 2 * nodes[node, 0] + (j >> 2)
                    children[born, 1] = 2 * nodes[node, 1] + (j >> 1 & 1)
                    children[born, 2] = 2 * nodes[node, 2] + (j & 1)
                    born += 1
            if ctl[2]:
                return False, np.zeros((0, 3), np.int64)
            classes[first:born] = _parent_class(born - first)
        nodes, parents = children[:born].copy(), classes[:born].copy()
    return finish(words, x, ctl) and len(nodes) == count, nodes
