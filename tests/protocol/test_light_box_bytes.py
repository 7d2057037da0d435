"""Every command and error of docs/reference/light-box-protocol.md, byte for byte, on the twin and on the firmware."""

import re
from zlib import crc32

import pytest

HELLO, HELLO_2 = "#00 HI 1", "#00 HI 2"


def framed(body):
    """Return a line with its checksum and end."""
    return f"{body}*{crc32(body.encode()):08X}\n".encode()


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
    ([HELLO_2], "#06 CH 6", "=06 ER 04"),
    ([HELLO_2], "#06 SL 4 H 30000", "=06 OK H 30000 3750"),
    ([HELLO_2], "#06 PU 5 H 60000 300000", "=06 OK H 60000 938"),
    ([HELLO_2], "#06 PU 5 H 60000 300001", "=06 ER 06"),
    ([HELLO_2], "#06 BL 5 H 60000 60000 1 6", "=06 ER 06"),
    ([HELLO_2], "#06 SL 5 H 60001", "=06 ER 05"),
    ([HELLO_2], "#06 PU 5 H 65535 1", "=06 ER 05"),
    ([HELLO_2, "#05 SL 2 L 5000"], "#06 SL 4 L 5", "=06 ER 11"),
    ([HELLO_2, "#05 SL 5 L 5000"], "#06 PU 0 L 5 5", "=06 ER 11"),
    ([HELLO_2, "#05 SL 5 L 5000"], "#06 RA 0 L 5 5", "=06 ER 11"),
    ([HELLO_2, "#05 SL 5 L 5000"], "#06 SL 0 L 0", "=06 OK L 0 0"),
    ([HELLO_2, "#04 SL 2 L 5000", "#05 OF 2"], "#06 SL 4 L 5000", "=06 OK L 5000 625"),
    ([HELLO_2], "#06 FS", "=06 OK 8 0"),
    ([HELLO_2], "#06 FL", "=06 OK 7 5000"),
    ([HELLO_2, "#05 FL"], "#06 FL", "=06 ER 06"),
    ([HELLO_2], "#06 FL 1", "=06 ER 03"),
    ([HELLO_2], "#06 FS 1", "=06 ER 03"),
    ([], "#06 FL", "=06 ER 07"),
    # an old host has what it knew, and no more
    ([HELLO], "#06 CH 4", "=06 ER 04"),
    ([HELLO], "#06 SL 5 H 5", "=06 ER 04"),
    ([HELLO], "#06 FL", "=06 ER 02"),
    ([HELLO], "#06 FS", "=06 ER 02"),
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
    # errors
    ([HELLO], "#20 XX", "=20 ER 02"),
    ([HELLO], "#21 sl 1 H 5", "=21 ER 02"),
    ([HELLO], "#22 SL 1 H", "=22 ER 03"),
    ([HELLO], "#23 SL 1 H 5 6", "=23 ER 03"),
    ([HELLO], "#24 SL 1 X 5", "=24 ER 03"),
    ([HELLO], "#25 SL 1 H -5", "=25 ER 03"),
    ([HELLO], "#26 SL 1 H 65536", "=26 ER 03"),
    ([HELLO], "#27 SL 1 H 4294967297", "=27 ER 03"),
    ([HELLO], "#28 SL 1  H 5", "=28 ER 03"),
    ([HELLO], "#29 SL 4 H 5", "=29 ER 04"),
    ([HELLO], "#2A SL 257 H 5", "=2A ER 04"),
    ([HELLO], "#2B SL one H 5", "=2B ER 03"),
    ([HELLO], "#2C SL 1 H 60001", "=2C ER 05"),
    ([HELLO], "#2D SL 3 H 20001", "=2D ER 05"),
    ([HELLO], "#2E PU 1 H 60001 5", "=2E ER 05"),
    ([HELLO], "#2F RA 1 H 60001 5", "=2F ER 05"),
    ([HELLO], "#30 BL 1 H 60001 5 5 1", "=30 ER 05"),
    ([HELLO], "#31 PU 0 H 60000 200001", "=31 ER 06"),
    ([HELLO], "#32 PU 0 H 60000 200000", "=32 OK H 60000 938"),
    ([HELLO], "#33 BL 0 H 60000 50000 1 5", "=33 ER 06"),
    ([HELLO], "#34 PU 1 H 5 0", "=34 ER 03"),
    ([HELLO], "#35 PU 1 H 5 600001", "=35 ER 03"),
    ([HELLO], "#36 BL 1 H 5 60001 1 1", "=36 ER 03"),
    ([HELLO], "#37 BL 1 H 5 1 1 65536", "=37 ER 03"),
    ([HELLO], "#38 RA 1 H 5 0", "=38 ER 03"),
    ([], "#39 SL 1 H 5", "=39 ER 07"),
    ([], "#3A RA 1 H 5 5", "=3A ER 07"),
    ([], "#3B PU 1 H 5 5", "=3B ER 07"),
    ([], "#3C BL 1 H 5 5 5 5", "=3C ER 07"),
    ([HELLO, "#3D SL 1 H 500"], "#3E RA 1 L 500 100", "=3E ER 08"),
    ([], "#3F HI 3", "=3F ER 09"),
    ([], "#3F HI 0", "=3F ER 09"),
    ([], "#40 HI", "=40 ER 03"),
    ([], "#41 HI 1 1", "=41 ER 03"),
    ([], "#42 EV 02", "=42 ER 10"),
    ([], "#43 EV 1", "=43 ER 03"),
    ([], "#44 EV 0a", "=44 ER 03"),
    ([], "#45 CH", "=45 ER 03"),
    ([], "#46 CH 9", "=46 ER 04"),
    ([], "#47 TM 1", "=47 ER 03"),
    ([], "#48 ST 1", "=48 ER 03"),
    ([], "#49 RB 1 1", "=49 ER 03"),
    ([], "#4A OF", "=4A ER 03"),
    ([], "#4B OF * *", "=4B ER 03"),
    ([], "#4C 1 2 3 4 5 6 7 8", "=4C ER 03"),
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


@pytest.mark.parametrize(("first", "request_", "answer"), EXCHANGES, ids=[entry[1] for entry in EXCHANGES])
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


def test_time_runs_between_two_questions(talker):
    """TM gives the line's and the answer's time in steps of 4 µs and the number of the latest event."""
    form = re.compile(rb"=0[12] OK ([0-9]+\.[0-9]{3}) ([0-9]+\.[0-9]{3}) 01\*[0-9A-F]{8}\n")
    first, second = form.fullmatch(talker.ask("#01 TM")), form.fullmatch(talker.ask("#02 TM"))
    assert float(first[1]) <= float(first[2]) < float(second[1])
    assert round(float(second[1]) * 1000) % 4 == 0


def test_session_starts_dark(talker):
    """HI darkens what was lit."""
    talker.ask(HELLO)
    talker.ask("#01 SL 0 H 40000")
    talker.ask("#02 HI 1")
    assert talker.duty("bleach") == 0
