"""The text of the package index: the README without its pictures and relative links, which have no files there."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface


def index_text(readme: str) -> str:
    """Return a README with its pictures left out and the texts of relative links in their places."""
    text = re.sub(r"^!\[[^]]*\]\([^)]*\)\n\n?", "", readme, flags=re.MULTILINE)
    return re.sub(r"\[([^]]+)\]\((?!https?://)[^)]*\)", r"\1", text)


class ReadmeHook(MetadataHookInterface):
    """Gives the build the text of the package index."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Set the field ``readme``."""
        text = index_text(Path(self.root, "README.md").read_text(encoding="utf-8"))
        metadata["readme"] = {"content-type": "text/markdown", "text": text}
