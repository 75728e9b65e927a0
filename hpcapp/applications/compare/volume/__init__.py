"""What two epochs of one place differ by: cut, fill and net volume, and how sure they are."""
