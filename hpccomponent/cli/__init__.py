"""What every command line here shares: verbs, verbosity, bars, and words that are safe to print."""
