"""URLs: which are taken, and that nothing which opens them is stated."""

from __future__ import annotations

import pytest

from occlog.errors import UsageError
from occlog.io.remote import identity, is_url, kind_of, public_url, without_secrets

SIGNED = "https://me:word@store.example/hall.mcap?X-Amz-Signature=abc123&X-Amz-Credential=key#part"


def test_names_of_files_are_no_urls() -> None:
    assert not any(map(is_url, ("hall.mcap", "/data/a:b/hall.mcap", "./s3/hall.mcap", "hall:1.mcap")))
    assert all(map(is_url, ("s3://b/hall.mcap", "memory://hall.mcap", "simplecache::s3://b/hall.mcap", SIGNED)))


@pytest.mark.parametrize(
    "url", ["ftp://h/x.mcap", "file:///etc/x.mcap", "simplecache::s3://b/x.mcap", "zip://a::s3://b"]
)
def test_other_kinds_are_refused(url: str) -> None:
    with pytest.raises(UsageError, match="are not read; give a file, or a URL of s3, gs, https"):
        kind_of(url)


def test_what_opens_a_url_is_not_stated() -> None:
    assert public_url(SIGNED) == "https://store.example/hall.mcap"
    words = without_secrets(f"403, message='Forbidden',\nurl='{SIGNED}' and s3://key:secret@bucket/x")
    assert not any(secret in words for secret in ("word", "abc123", "key", "secret"))
    assert "store.example/hall.mcap" in words


def test_a_query_that_names_another_file_is_distinguished_from_a_signature() -> None:
    assert identity(SIGNED) == "https://store.example/hall.mcap"
    assert identity("https://me:word@h/get?file=1&Expires=9&X-Goog-Date=2&part=b#x") == "https://h/get?file=1&part=b"
