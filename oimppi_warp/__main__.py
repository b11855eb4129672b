"""``python -m oimppi_warp`` is the command ``oimppi``."""

from oimppi_warp.cli.main import main

if __name__ == "__main__":
    raise SystemExit(main())
