"""Where the sources are: links to the repository, `Edit this page`, and the version in the header.

A hook of mkdocs.yml. The address is in one place, the environment variable NW_EVAL_REPOSITORY,
which the workflow of the site sets. Without it no page has a link to a repository, and commands
have the placeholder OWNER.
"""

from __future__ import annotations

import os
import re
from typing import Any
from urllib.parse import urlsplit

VARIABLE = "NW_EVAL_REPOSITORY"

_ADDRESS = re.compile(r"https://[\w.-]+(?::\d+)?/[\w.-]+(?:/[\w.-]+)+")
_PLACEHOLDER = re.compile(r"<!-- owner -->.*?<!-- /owner -->", re.DOTALL)
_NAME = re.compile(r'(<div class="md-header__topic">\s*<span class="md-ellipsis">\s*nw-eval)')
_NOT_EDITED = re.compile(r"reference/python/\w+\.md")
"""Pages whose text is in the sources alone."""


def address() -> str:
    """Return the address of the repository; nothing where it is not set.

    Raises:
        ValueError: it is set and is no address.
    """
    found = os.environ.get(VARIABLE, "").rstrip("/").removesuffix(".git")
    if found and not _ADDRESS.fullmatch(found):
        raise ValueError(
            f"{VARIABLE}={found!r} is not the address of a repository; give one such as "
            "https://github.com/OWNER/nw-eval, or unset it"
        )
    return found


def path_of(repository: str) -> str:
    """Return owner and name of a repository."""
    return urlsplit(repository).path.strip("/")


def with_address(text: str, repository: str) -> str:
    """Return a page with the address in place of the placeholder and of what is said of it.

    Args:
        text: of the page.
        repository: the address; empty = the placeholder stays.
    """
    if not repository:
        return text
    text = _PLACEHOLDER.sub("", text)
    text = text.replace("https://github.com/OWNER/nw-eval", repository)
    return text.replace("OWNER/nw-eval", path_of(repository))


# The hook of MkDocs.


def on_config(config: Any) -> Any:
    """Set the links to the repository, if its address is known."""
    repository = address()
    if repository:
        host = urlsplit(repository).netloc
        config.repo_url = repository
        config.repo_name = path_of(repository)
        config.edit_uri = "-/edit/main/docs/" if "gitlab" in host else "edit/main/docs/"
    return config


def on_page_markdown(markdown: str, *, page: Any, config: Any, files: Any) -> str:  # noqa: ARG001
    """Put the address into a page, and see that `Edit this page` leads to its text."""
    if page.edit_url and page.file.src_uri == "changelog.md":
        page.edit_url = page.edit_url.replace("docs/changelog.md", "CHANGELOG.md")
    elif _NOT_EDITED.fullmatch(page.file.src_uri):
        page.edit_url = None
    return with_address(markdown, address())


def on_post_page(output: str, *, page: Any, config: Any) -> str:  # noqa: ARG001
    """Put the version into the header. The theme would ask GitHub for stars: it does not."""
    from nw_base import __version__

    changes = "../" * page.file.src_uri.count("/") + "changelog.html"
    version = rf'\1 <a class="version" href="{changes}">{__version__}</a>'
    return _unasked(_NAME.sub(version, output, count=1))


def on_post_template(output: str, *, template_name: str, config: Any) -> str:  # noqa: ARG001
    """Ask GitHub for nothing from the page of an address that is none, either."""
    return _unasked(output)


def _unasked(output: str) -> str:
    return output.replace(' data-md-component="source"', "")
