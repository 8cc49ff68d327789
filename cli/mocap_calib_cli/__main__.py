"""Run the command as `python -m mocap_calib_cli`, where scripts are not on the path."""

from mocap_calib_cli.main import main

main()
