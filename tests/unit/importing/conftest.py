"""Files as laboratories have them, written by other programs' libraries with known content."""

import gzip

import numpy as np
import pytest
import tifffile
from astropy.io import fits


@pytest.fixture
def write_fits(tmp_path):
    """Return a function that writes one FITS file from values and header cards, gzipped where its name ends so."""

    def write(name, values, history=(), **cards):
        unit = fits.PrimaryHDU(np.asarray(values))
        for key, value in cards.items():
            unit.header[key.replace("_", "-")] = value
        for line in history:
            unit.header["HISTORY"] = line
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        plain = path.with_name(path.name.removesuffix(".gz"))
        unit.writeto(plain)
        if path != plain:
            path.write_bytes(gzip.compress(plain.read_bytes(), 1))
            plain.unlink()
        return path

    return write


RED_EDGE_XMP = """<?xpacket begin=""?><x:xmpmeta xmlns:x="adobe:ns:meta/">
<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
<rdf:Description xmlns:MicaSense="http://micasense.com/MicaSense/1.0/">
<MicaSense:RadiometricCalibration><rdf:Seq><rdf:li>1.4e-4</rdf:li><rdf:li>1.0e-7</rdf:li><rdf:li>-5e-6</rdf:li></rdf:Seq>
</MicaSense:RadiometricCalibration>
<MicaSense:DarkRowValue><rdf:Seq><rdf:li>{dark}</rdf:li><rdf:li>{dark}</rdf:li></rdf:Seq></MicaSense:DarkRowValue>
</rdf:Description>
<rdf:Description xmlns:Camera="http://pix4d.com/1.0"><Camera:BandName>{band}</Camera:BandName>
<Camera:VignettingCenter><rdf:Seq><rdf:li>30</rdf:li><rdf:li>20</rdf:li></rdf:Seq></Camera:VignettingCenter>
<Camera:VignettingPolynomial><rdf:Seq><rdf:li>-0.001</rdf:li><rdf:li>-1e-4</rdf:li></rdf:Seq></Camera:VignettingPolynomial>
</rdf:Description></rdf:RDF></x:xmpmeta>"""


@pytest.fixture
def write_raw_tiff(tmp_path):
    """Return a function that writes a raw TIFF with EXIF, black level tag and a maker's XMP."""

    def write(name, values, *, iso=100, exposure=(2, 1000), dark=5000, band="Blue", black=4800):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        packet = RED_EDGE_XMP.format(dark=dark, band=band).encode()
        tags = [
            (271, "s", 0, "MicaSense", True),
            (272, "s", 0, "RedEdge", True),
            (33434, "2I", 1, exposure, True),
            (34867, "I", 1, iso, True),
            (50714, "H", 4, (black,) * 4, True),
            (700, "B", len(packet), packet, True),
        ]
        tifffile.imwrite(path, np.asarray(values), photometric="minisblack", extratags=tags)
        return path

    return write
