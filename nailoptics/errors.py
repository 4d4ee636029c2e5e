"""What can go wrong, in the user's words: one line, and the exit code it ends with."""


class NailopticsError(Exception):
    """An error whose message is one clear line for the user."""

    exit_code = 1


class InputError(NailopticsError):
    """The user's input is at fault: which field, which rule, which value, what to do."""

    exit_code = 2


class NotReachedError(NailopticsError):
    """A tolerance or a time limit could not be met; `result` is what was reached."""

    exit_code = 3

    def __init__(self, message: str, *, result: object = None) -> None:
        super().__init__(message)
        self.result = result


class WriteError(InputError):
    """A file cannot be written where the user wants it; on a full disk no input is at fault, and the exit code is 1."""

    def __init__(self, message: str, *, full: bool = False) -> None:
        super().__init__(message)
        self.exit_code = 1 if full else InputError.exit_code
