"""Programs of the checkout that make what the packages carry."""
