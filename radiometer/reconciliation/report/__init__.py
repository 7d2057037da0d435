"""What was found, as result, report and camera model."""
