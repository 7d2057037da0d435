"""Distinguishes a browser, or any client of HTTP or TLS, from an instrument's client by what it sends.

A web page may have the browser of this machine send bytes of its choice to any loopback port: the body of a POST, line
by line. The browser cannot help sending its request line and headers before them; by these it is known. No program
message of ours begins so: a mnemonic holds no hyphen, and no blank follows a root header but before its arguments.
"""

from __future__ import annotations

import re
from typing import Final

_METHODS: Final = rb"GET|HEAD|POST|PUT|DELETE|OPTIONS|CONNECT|PRI|PROPFIND"
_METHODS_WITH_TARGET: Final = rb"(?:TRACE|PATCH)[ \t]+[/*h]"  # both are also long forms of our own mnemonics
_HEADERS: Final = rb"Host|Connection|Accept|Origin|Referer|Cookie|Upgrade|Expect|Pragma|Range|[a-z]+(?:-[a-z]+)+"
_STRANGE: Final = re.compile(
    rb"(?:\A|\n)[\x00-\x09\x0b-\x20]*"  # what the lexer passes over at the beginning of a message
    rb"(?:(?:" + _METHODS + rb")[ \t]|" + _METHODS_WITH_TARGET + rb"|(?:" + _HEADERS + rb")[ \t]*:"
    rb"|[^\n]{0,4096}[ \t]HTTP/\d)"
    rb"|(?:\A|\n)\x16\x03",  # a TLS record: handshake, version 3.x (RFC 8446, 5.1)
    re.IGNORECASE,
)


def is_other_protocol(received: bytes | bytearray) -> bool:
    """Return whether bytes that begin with a line hold the beginning of a line of HTTP or TLS.

    Args:
        received: What came, from the beginning of a line on; its last line may be unfinished.
    """
    return _STRANGE.search(received) is not None
