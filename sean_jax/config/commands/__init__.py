"""The options of each command: a class in the file of its name; those of commands without options stand here."""

from sean_jax.config.components import Config


class DoctorConfig(Config):
    """Show versions, devices and folders of this machine, and cures for slow or missing parts."""


class ListConfig(Config):
    """List the choices of each option."""


class SchemaConfig(Config):
    """Print the JSON Schema of config.yaml, by which editors complete and check it."""
