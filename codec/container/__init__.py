"""`.slod` files: packets one after the other, an index at the end. FORMAT.md section 15.

`SlodReader` and `SlodWriter` read and write files; `joined` makes one of others (`FilePart`) without copying.
"""

from codec.container.join import FilePart, Piece, joined, size_of
from codec.container.layout import Entry
from codec.container.reader import SlodReader
from codec.container.writer import SlodWriter

__all__ = ["Entry", "FilePart", "Piece", "SlodReader", "SlodWriter", "joined", "size_of"]
