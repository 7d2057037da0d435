"""From a folder of photographs to a bracket: files, exposures, fall-off, alignment, response."""
