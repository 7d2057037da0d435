"""Sessions by other hands' rules: written from the file formats alone, by equations of their own.

Nothing here imports the instrument or its forward model; a test holds it to that.
"""
