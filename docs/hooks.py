"""What mkdocs does not do by itself: links to files beside the pages."""

import re
from typing import Any

UPWARDS = re.compile(r"\[([^\]]+)\]\(((?:\.\./)+)([^)\s]+)\)")


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Change a page before it is turned into HTML.

    Args:
        markdown: of the page.
        page: of mkdocs.

    Returns:
        Markdown.
    """
    return name_outside(markdown, page.file.src_uri)


def name_outside(markdown: str, place: str) -> str:
    """Name files outside of the pages instead of linking them: the site stands without the repository.

    Args:
        markdown: of a page.
        place: of the page in docs/.

    Returns:
        Markdown.
    """

    def name(link: re.Match) -> str:
        return f"{link[1]} (`{link[3]}`)" if link[2].count("/") > place.count("/") else link[0]

    return UPWARDS.sub(name, markdown)
