"""`python -m riecjax`, which is the command line."""

from riecjax.cli.start import main

if __name__ == "__main__":
    main()
