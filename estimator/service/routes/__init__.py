"""HTTP routes: the application includes the `router` of every module here."""
