"""The global optimum: relaxation, search for lower minima, certificate."""
