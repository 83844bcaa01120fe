"""Checks every link and picture of a built site: each must lead to a file, each anchor to an id.

    python docs/check_links.py out/docs

Links to the network are counted, not followed; a script, style or picture from there is an error.
Pages in `fortran` are checked as targets alone.
"""

import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit


class _Page(HTMLParser):
    def __init__(self, path: Path) -> None:
        super().__init__()
        self.links: list[tuple[str, str]] = []
        self.ids: set[str] = set()
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if value is None:
                continue
            if name in ("id", "name"):
                self.ids.add(value)
            elif name in ("href", "src"):
                self.links.append((tag, value))


def main(root: Path) -> int:
    """Prints what is broken; returns how much is."""
    pages = {path.resolve(): _Page(path) for path in root.rglob("*.html")}
    broken, followed, outside = 0, 0, 0
    for path, page in pages.items():
        if "fortran" in path.relative_to(root.resolve()).parts:
            continue
        for tag, link in page.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                outside += 1
                if tag != "a" and parts.scheme not in ("data", "mailto"):
                    print(f"{path.relative_to(root.resolve())}: {link} needs the network")
                    broken += 1
                continue
            followed += 1
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if target.is_dir():
                target /= "index.html"
            anchor = unquote(parts.fragment)
            missing = not target.exists() or (
                anchor and target in pages and anchor not in pages[target].ids
            )
            if missing and anchor != "":
                missing = link != "#"
            if missing:
                print(f"{path.relative_to(root.resolve())}: {link} leads nowhere")
                broken += 1
    print(f"{len(pages)} pages, {followed} links followed, {outside} outside, {broken} broken")
    return broken


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])) > 0)
