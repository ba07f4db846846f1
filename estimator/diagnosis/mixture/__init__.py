"""One probability for everything: which listed causes and which departures that no list holds stand beside each other in the readings."""
