"""Every command and error of docs/reference/light-box-protocol.md, byte for byte, on the twin and on the firmware."""

import re
from zlib import crc32

import pytest

HELLO, HELLO_2 = "#00 HI 1", "#00 HI 2"


def framed(body):
    """Return a line with its checksum and end."""
    return f"{body}*{crc32(body.encode()):08X}\n".encode()


# requests to make first, code of the error, requests that are answered with it
REFUSED = (
    ((), "07", ("FL", "SL 1 H 5", "RA 1 H 5 5", "PU 1 H 5 5", "BL 1 H 5 5 5 5")),
    ((HELLO,), "04", ("CH 4", "SL 5 H 5", "SL 4 H 5", "SL 257 H 5")),
    ((HELLO,), "02", ("FL", "FS", "XX", "sl 1 H 5")),
    (
        (HELLO,),
        "03",
        ("SL 1 H", "SL 1 H 5 6", "SL 1 X 5", "SL 1 H -5", "SL 1 H 65536", "SL 1 H 4294967297", "SL 1  H 5"),
    ),
    (
        (HELLO,),
        "03",
        ("SL one H 5", "PU 1 H 5 0", "PU 1 H 5 600001", "BL 1 H 5 60001 1 1", "BL 1 H 5 1 1 65536", "RA 1 H 5 0"),
    ),
    ((HELLO,), "05", ("SL 1 H 60001", "SL 3 H 20001", "PU 1 H 60001 5", "RA 1 H 60001 5", "BL 1 H 60001 5 5 1")),
    ((), "03", ("HI", "HI 1 1", "EV 1", "EV 0a", "CH", "TM 1", "ST 1", "RB 1 1", "OF", "OF * *", "1 2 3 4 5 6 7 8")),
)
# requests to make first, request, answer without its checksum
EXCHANGES = [
    ([], "#01 HI 1", "=01 OK radiometer-light-box 1 2.1 LB000007 4"),
    ([], "#01 HI 2", "=01 OK radiometer-light-box 2 2.1 LB000007 6"),
    ([], "#02 CH 0", "=02 OK bleach 0 1024 1953 65535 60000 47000000 78"),
    ([], "#03 CH 1", "=03 OK spot 453 8192 1953 65535 60000 846000000 1410"),
    ([], "#04 CH 2", "=04 OK spot_red 640 8192 1953 65535 60000 846000000 1410"),
    ([], "#05 CH 3", "=05 OK fixation 640 1024 1953 65535 20000 846000000 1410"),
    ([HELLO_2], "#06 CH 4", "=06 OK spot_green 505 8192 1953 65535 60000 846000000 1410"),
    ([HELLO_2], "#06 CH 5", "=06 OK field 0 1024 1953 65535 60000 70500000 118"),
    ([HELLO_2], "#06 SL 4 H 30000", "=06 OK H 30000 3750"),
    ([HELLO_2], "#06 PU 5 H 60000 300000", "=06 OK H 60000 938"),
    ([HELLO_2, "#05 SL 2 L 5000"], "#06 SL 4 L 5", "=06 ER 11"),
    ([HELLO_2, "#05 SL 5 L 5000"], "#06 PU 0 L 5 5", "=06 ER 11"),
    ([HELLO_2, "#05 SL 5 L 5000"], "#06 RA 0 L 5 5", "=06 ER 11"),
    ([HELLO_2, "#05 SL 5 L 5000"], "#06 SL 0 L 0", "=06 OK L 0 0"),
    ([HELLO_2, "#04 SL 2 L 5000", "#05 OF 2"], "#06 SL 4 L 5000", "=06 OK L 5000 625"),
    ([HELLO_2], "#06 FS", "=06 OK 8 0"),
    ([HELLO_2], "#06 FL", "=06 OK 7 5000"),
    ([HELLO_2, "#05 FL"], "#06 FL", "=06 ER 06"),
    # an old host has what it knew, and no more
    ([HELLO], "#07 SL 1 H 30000", "=07 OK H 30000 3750"),
    ([HELLO], "#08 SL 1 L 65535", "=08 OK L 65535 8192"),
    ([HELLO], "#09 SL 0 H 0", "=09 OK H 0 0"),
    ([HELLO], "#0A SL 0 H 60000", "=0A OK H 60000 938"),
    ([HELLO], "#0B RA 1 H 1000 500", "=0B OK H 1000 125"),
    ([HELLO], "#0C PU 2 L 500 600000", "=0C OK L 500 63"),
    ([HELLO], "#0D BL 1 H 4000 100 900 0", "=0D OK H 4000 500"),
    ([HELLO], "#0E BL 1 H 4000 60000 60000 5", "=0E OK H 4000 500"),
    ([HELLO], "#0F OF *", "=0F OK"),
    ([HELLO], "#10 OF 3", "=10 OK"),
    ([], "#11 OF *", "=11 OK"),
    ([], "#12 RB 2", "=12 OK O L 0 0 846000000"),
    ([HELLO, "#13 SL 3 L 20000"], "#14 OF 3", "=14 OK"),
    ([], "#15 EV 01", "=15 OK BO P 0.008"),
    ([HELLO], "#32 PU 0 H 60000 200000", "=32 OK H 60000 938"),
    ([HELLO, "#3D SL 1 H 500"], "#3E RA 1 L 500 100", "=3E ER 08"),
    ([HELLO_2], "#20 CH 6", "=20 ER 04"),
    ([HELLO_2], "#20 PU 5 H 60000 300001", "=20 ER 06"),
    ([HELLO_2], "#20 BL 5 H 60000 60000 1 6", "=20 ER 06"),
    ([HELLO_2], "#20 SL 5 H 60001", "=20 ER 05"),
    ([HELLO_2], "#20 PU 5 H 65535 1", "=20 ER 05"),
    ([HELLO_2], "#20 FL 1", "=20 ER 03"),
    ([HELLO_2], "#20 FS 1", "=20 ER 03"),
    ([HELLO], "#20 PU 0 H 60000 200001", "=20 ER 06"),
    ([HELLO], "#20 BL 0 H 60000 50000 1 5", "=20 ER 06"),
    ([], "#20 HI 3", "=20 ER 09"),
    ([], "#20 HI 0", "=20 ER 09"),
    ([], "#20 EV 02", "=20 ER 10"),
    ([], "#20 CH 9", "=20 ER 04"),
    *(([*first], f"#21 {words}", f"=21 ER {code}") for first, code, refused in REFUSED for words in refused),
]

# lines that are not requests
DAMAGED = [
    b"#01 HI 1*00000000\n",
    b"#01 HI 1\n",
    b"hello\n",
    b"#01 HI 1*e44f4ddb\n",
    b"#01*" + f"{crc32(b'#01'):08X}".encode() + b"\n",
    b"#0G HI 1*" + f"{crc32(b'#0G HI 1'):08X}".encode() + b"\n",
    b"#01 " + b"A" * 80 + b"\n",
    b"\x00\xff\x80\n",
]


@pytest.mark.parametrize(
    ("first", "request_", "answer"), EXCHANGES, ids=[" ".join((*entry[0], entry[1])) for entry in EXCHANGES]
)
def test_answer(talker, first, request_, answer):
    """A request is answered with exactly these bytes."""
    for before in first:
        talker.ask(before)
    assert talker.ask(request_) == framed(answer)


@pytest.mark.parametrize("raw", DAMAGED)
def test_damaged_line_is_refused(talker, raw):
    """What is not a whole request is answered with error 01 and no number."""
    assert talker.tell(raw) == framed("=-- ER 01")


def test_a_request_is_taken_however_it_comes(talker):
    """As in the document, with literal checksums; after garbage, which ends at its #; with CR LF; and in two halves."""
    assert talker.boot == framed("!01 BO P 0.008")
    assert talker.tell(b"\x00\xff=07 OK #12 SL" + framed("#01 HI 1")) == framed(
        "=01 OK radiometer-light-box 1 2.1 LB000007 4"
    )
    assert talker.tell(b"#07 SL 1 H 30000*C04ED159\n") == b"=07 OK H 30000 3750*34925C28\n"
    line = framed("#01 OF *")
    assert talker.tell(line.replace(b"\n", b"\r\n")) == framed("=01 OK")
    assert (talker.tell(line[:7]), talker.tell(line[7:])) == (b"", framed("=01 OK"))


def test_session_starts_dark(talker):
    """HI darkens what was lit; TM gives line and answer in steps of 4 µs and the number of the latest event."""
    talker.ask(HELLO)
    talker.ask("#01 SL 0 H 40000")
    talker.ask("#02 HI 1")
    assert talker.duty("bleach") == 0
    form = re.compile(rb"=0[12] OK ([0-9]+\.[0-9]{3}) ([0-9]+\.[0-9]{3}) 01\*[0-9A-F]{8}\n")
    first, second = form.fullmatch(talker.ask("#01 TM")), form.fullmatch(talker.ask("#02 TM"))
    assert float(first[1]) <= float(first[2]) < float(second[1])
    assert round(float(second[1]) * 1000) % 4 == 0
