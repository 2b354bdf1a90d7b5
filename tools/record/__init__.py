"""Put figures of finished runs into result files and READMEs, and run the experiments of the paper."""
