"""`.slod` files: packets one after the other, an index at the end. FORMAT.md section 15.

`SlodReader` and `SlodWriter` read and write files; `splice` makes one of parts of others (`FilePart`) without copying.
"""

from codec.container.layout import Entry
from codec.container.reader import SlodReader
from codec.container.splice import FilePart, Piece, size_of, splice
from codec.container.writer import SlodWriter

__all__ = ["Entry", "FilePart", "Piece", "SlodReader", "SlodWriter", "size_of", "splice"]
