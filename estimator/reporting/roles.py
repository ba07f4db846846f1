"""What a diagnosis makes of a hypothesis, as sentences, tables, figures and the page tell it; loads no plotting library."""

from __future__ import annotations

from enum import StrEnum


class Role(StrEnum):
    """What a diagnosis makes of a hypothesis, in the words of a legend; drawn in this order."""

    NAMED = "named by the verdict"
    ALTERNATIVE = "cannot be told from it"
    STAND_IN = "not sure enough to be stated"
    OTHER = "not needed"
    LEFT = "what no known cause explains"

    @property
    def key(self) -> str:
        """The role in JSON.

        Examples:
            >>> Role.STAND_IN.key
            'stand-in'
        """
        return self.name.lower().replace("_", "-")
