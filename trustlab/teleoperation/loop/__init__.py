"""One operator and one robot: settings, schemes and the compiled loop of Fig. 3.1."""
