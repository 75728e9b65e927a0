"""Points and keys on a lattice: counted, sorted, packed, looked up."""
