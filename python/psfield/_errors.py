"""Warnings of the package."""


class PsfieldWarning(UserWarning):
    """Something that nothing checks and that a user should know, such as stars drawn from stamps that are too coarse."""
