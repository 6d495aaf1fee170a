"""What pages of the docs show of files: tables of results and examples, written into the pages themselves, so
that they are whole wherever they are read. In a page stands

    <!-- begin benchmarks/results/speed.md -->
    <!-- end -->

and between the marks whatever `python -m benchmarks.page` last found in that file. A test compares them.
"""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
MARKED = re.compile(r"^<!-- begin (\S+) -->\n(.*?)(?:^(<!-- end -->)$|\Z)", re.MULTILINE | re.DOTALL)
FENCED = {".toml", ".py", ".csv", ".json"}


def included(page: str) -> list[str]:
    """The files that a page shows, as their marks name them."""
    return [found[1] for found in MARKED.finditer(page)]


def filled(page: str, root: Path) -> str:
    """A page with what its marks ask for between them.

    Args:
        page: its text.
        root: folder that the names of the files start from.

    Raises:
        ValueError: a mark names no file, or has no end.
    """

    def fill(found: re.Match[str]) -> str:
        name, path = found[1], root / found[1]
        if not path.is_file():
            raise ValueError(f"<!-- begin {name} -->: no such file")
        if found[3] is None or "<!-- begin" in found[2]:
            raise ValueError(f"<!-- begin {name} -->: no end; write <!-- end --> on a line of its own")
        return f"<!-- begin {name} -->\n\n{_shown(path)}\n\n<!-- end -->"

    return MARKED.sub(fill, page)


def _shown(path: Path) -> str:
    """A file as a page shows it: code in a block, markdown without a title of its own."""
    text = path.read_text(encoding="utf-8").strip("\n")
    if path.suffix in FENCED:
        return f"```{path.suffix[1:]}\n{text}\n```"
    return re.sub(r"\A# .*\n+", "", text)


def fill_all() -> list[Path]:
    """Write into every page of the docs what its marks ask for; the pages that changed."""
    changed = []
    for page in sorted((ROOT / "docs").rglob("*.md")):
        text = page.read_text(encoding="utf-8")
        new = filled(text, ROOT)
        if new != text:
            page.write_text(new, encoding="utf-8")
            changed.append(page)
    return changed
