"""What several demos share, and the models behind them."""
