"""Point clouds as text: lines of numbers in all their dialects, and PTX."""
