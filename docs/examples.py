"""A MkDocs hook: a line of a page that is a link to a file of `examples` alone shows the file; a script is run first.

What it prints stands below it. A script that fails, such as at its assertion, fails the build.
"""

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
LINK = re.compile(r"^\[[^\]]+\]\((examples/\w+\.(\w+))\)$", re.MULTILINE)
LANGUAGES = {"py": "python"}


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """`markdown` with the files that it links to, and what the scripts among them print."""
    folder = Path(page.file.abs_src_path).parent

    def shown(found: re.Match[str]) -> str:
        path, kind = folder / found[1], found[2]
        block = f"{found[0]}\n\n```{LANGUAGES.get(kind, kind)}\n{path.read_text(encoding='utf-8')}```"
        return f"{block}\n\nprints\n\n```text\n{printed(path)}```" if kind == "py" else block

    return LINK.sub(shown, markdown)


def printed(script: Path) -> str:
    """What a script prints. Raises CalledProcessError where it fails."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, script], env=environment, stdout=subprocess.PIPE, text=True, check=True)
    return done.stdout
