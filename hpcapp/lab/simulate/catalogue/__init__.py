"""The analytic models, by what they test."""
