"""`python -m riecjax`, which is the command line."""

from riecjax.cli.start import main

main()
