"""When tiles can be observed, and the order in which they are observed in a night."""
