"""The command line: commands, plots, reports and the demo."""

__version__ = "0.1.0"


def main() -> None:
    """Entry point of ``sgp``."""
    _enter("main")


def capture() -> None:
    """Entry point of ``capture``, the same as ``sgp capture``."""
    _enter("capture")


def _enter(name: str) -> None:
    from sgp._entry import enter

    def run() -> None:
        from sgp import app

        getattr(app, name)()

    enter(run)
