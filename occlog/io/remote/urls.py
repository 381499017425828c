"""URLs of files that lie elsewhere: which are taken, and how they are named without what opens them.

Passwords before the host and signatures after the question mark open a file to whoever reads them.  They never leave
this process but to the server: not into tables, provenance or messages.
"""

from __future__ import annotations

import re

from occlog.errors import UsageError

EXTRAS = {"s3": "s3", "gs": "gs", "https": "remote", "http": "remote", "memory": "remote"}
"""Kinds of URLs, and the extra of occlog that each wants."""
READ_ONLY = ("https", "http")
"""Kinds that nothing is written to."""
_URL = re.compile(r"^([A-Za-z][A-Za-z0-9+.-]*)(?:::|://)")
_SECRETS = re.compile(r"(?<=://)[^/@\s'\"]*@|\?[^\s'\")>]+")
_SIGNATURE = re.compile(
    r"(?:x-amz-|x-goog-|awsaccesskeyid=|googleaccessid=|signature=|expires=|key-pair-id=|policy=)", re.IGNORECASE
)
"""Beginning of the parts of a query that differ each time that a URL is signed."""
MOST_WORDS = 160
"""Characters of the words of a library that a message repeats."""


def is_url(text: str) -> bool:
    """Whether a text is a URL, not the name of a file."""
    return _URL.match(text) is not None


def kind_of(url: str) -> str:
    """The kind of a URL, e.g. `s3`; UsageError for those that occlog does not take."""
    found = _URL.match(url)
    kind = found.group(1).lower() if found else ""
    if kind not in EXTRAS or "::" in url:
        raise UsageError(f"{shown(url)}: {kind}: is not taken; give a file, or one of {', '.join(EXTRAS)}")
    return kind


def without_end(place: str) -> str:
    """A folder, or its URL, without slashes at its end: in stores, names behind two slashes are other ones."""
    kind, mark, path = place.partition("://")
    return f"{kind}{mark}{path.rstrip('/')}" if is_url(place) else place


def shown(url: str) -> str:
    """The URL without user, password, query and fragment."""
    kind, mark, rest = url.partition("://")
    path = re.split(r"[?#]" if kind.lower() in READ_ONLY else r"[?]", rest, maxsplit=1)[0]
    host, slash, below = path.partition("/")
    return f"{kind}{mark}{host.rpartition('@')[2]}{slash}{below}"


def identity(url: str) -> str:
    """The URL without what only opens it: without user and password, and without signatures in its query."""
    query = url.partition("?")[2].partition("#")[0]
    asked = "&".join(part for part in query.split("&") if not _SIGNATURE.match(part))
    return f"{shown(url)}?{asked}" if asked else shown(url)


def scrubbed(text: str) -> str:
    """Words of a library about a URL, in one line and without what opens it."""
    return _SECRETS.sub("", " ".join(text.split()))[:MOST_WORDS]
