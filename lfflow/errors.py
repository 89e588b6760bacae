"""The errors that lfflow raises on purpose; everything else is a bug."""


class LfflowError(Exception):
    """Base of all errors whose message is meant for the person at the keyboard."""


class FormatError(LfflowError):
    """A file is not what it claims to be: the message names the file, what was found and what was expected."""


class LatticeNotFoundError(LfflowError):
    """A picture carries no microlens lattice that can be measured; the message says why."""


class SchemaError(LfflowError):
    """A dataset or a store differs from its declaration."""


class CollectionError(LfflowError):
    """A collection cannot be used as asked: not there, held by another run, or damaged."""
