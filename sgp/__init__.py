"""The command line: commands, plots, reports and the demo."""

# Of `typing`, which `python -m` would search in the working directory.
TYPE_CHECKING = False

if TYPE_CHECKING:
    from sgp.results import ResultRecord as ResultRecord
    from sgp.results import read_record as read_record

__version__ = "0.2.0"
__all__ = ["ResultRecord", "capture", "main", "read_record"]


def __getattr__(name: str) -> object:
    # Loaded on first use: the commands start without it.
    if name in ("ResultRecord", "read_record"):
        from sgp.results import record as _record

        return getattr(_record, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def main() -> None:
    """Entry point of ``sgp``."""
    _enter("main")


def capture() -> None:
    """Entry point of ``capture``, the same as ``sgp capture``."""
    _enter("capture")


def _enter(name: str) -> None:
    from sgp.cli.entry import enter

    def run() -> None:
        from sgp import app

        getattr(app, name)()

    enter(run)
