"""`python -m streamlod.server.cli`."""

from streamlod.server.cli.main import main

main()
