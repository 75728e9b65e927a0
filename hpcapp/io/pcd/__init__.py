"""PCD, the files of the Point Cloud Library."""
