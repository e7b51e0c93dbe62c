"""The streamlod bitstream: integer anchor states to packets and files, and back. See FORMAT.md."""
