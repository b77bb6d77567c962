"""Find: masks, objects of masks, the memory bank behind them, clicks and words."""
