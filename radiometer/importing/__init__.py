"""Reading what laboratories have: FITS, TIFF with EXIF and XMP, EMVA 1288 descriptors, tables of statistics.

capture = open_capture(Path("night-of-2017"))      # a capture set, whatever the files are
capture.header, capture.read_frame(0)
imported_of(capture)                               # what was taken from where, what is missing, what is doubted
"""

from radiometer.importing.found import ImportOptions, ImportRecord, imported_of
from radiometer.importing.sources import copy_into, import_into, import_sources, is_foreign, open_capture, statistics_of

__all__ = [
    "ImportOptions", "ImportRecord", "copy_into", "import_into", "import_sources", "imported_of", "is_foreign",
    "open_capture", "statistics_of",
]  # fmt: skip
