"""`.slod` files: packets one after the other, an index at the end. FORMAT.md section 15.

`SlodReader` and `SlodWriter` read and write files; `joined` makes one of others (`FilePart`) without copying.
"""

from streamlod.codec.container.join import FilePart, Piece, joined, size_of
from streamlod.codec.container.layout import Entry
from streamlod.codec.container.reader import SlodReader
from streamlod.codec.container.writer import SlodWriter

__all__ = ["Entry", "FilePart", "Piece", "SlodReader", "SlodWriter", "joined", "size_of"]
