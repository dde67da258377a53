"""Planning of studies: power by simulation, and whole studies with simulated participants."""
