"""What can go wrong with data. Every message says what, where and what to do, in one line."""


class MissingPathError(Exception):
    """A path that was named does not exist (exit code 2 at the front door)."""


class StorageError(Exception):
    """The disk under a capture refused a write (exit code 3 at the front door)."""


class SessionInUseError(StorageError):
    """Another process is writing to the session."""


class DataError(Exception):
    """An input or session is damaged, incomplete, inconsistent or not understood (exit code 4)."""
