"""Examples at the end of the help text of each command."""

PLAN_EXAMPLES = """\b
Examples:
  rfpsurvey plan
  rfpsurvey plan example:anticenter --center "95 23" --epoch 2026.5
  rfpsurvey plan stars.fits --center "06h20m00s +23d00m00s" \\
      --output tile.fits --plot tile.png
  rfpsurvey plan stars.fits --output tile.fits --report tile.html
  rfpsurvey plan stars.fits --plot tile.png --set output.targets=outcome \\
      --set output.quality=quality.png
  rfpsurvey plan stars.csv --instrument sdss_apo --center "95.0 23.0" \\
      --position-angle 40 --set equinox=J2026.0
  rfpsurvey plan stars.fits --allocator optimal --constraint sky=20 \\
      --set options.sky_separation=10
  rfpsurvey plan stars.fits --constraint "required 4711" \\
      --constraint "keep_out 95.0 23.1 0.01"
  rfpsurvey plan stars.fits --center "95 23" --write-plan plan.toml
  rfpsurvey plan plan.toml --output tile.fits
"""

COMPARE_ALLOCATORS_EXAMPLES = """\b
Examples:
  rfpsurvey compare-allocators
  rfpsurvey compare-allocators stars.fits --instrument moons \\
      --plot allocators.png --report allocators.html
  rfpsurvey compare-allocators stars.fits --constraint sky=20 \\
      --allocator network_flow --allocator optimal
"""

COMPARE_EXAMPLES = """\b
Examples:
  rfpsurvey compare
  rfpsurvey compare lamost design.toml --targets-per-positioner 2 \\
      --plot comparison.png --output comparison.ecsv
  rfpsurvey compare sdss_apo moons --catalog stars.fits \\
      --center "06h20m00s +23d00m00s" --allocator optimal
  rfpsurvey compare lamost desi pfs --density 1000 --n-realizations 2 \\
      --report comparison.html
"""

CONVERT_EXAMPLES = """\b
Examples:
  rfpsurvey convert confSummary-26.par plan.ecsv
  rfpsurvey convert tile.fits confSummary-26.par.gz
  rfpsurvey plan targets.fits --instrument fp-metrology.csv --output tile.fits
  rfpsurvey convert tile.fits fiberassign-000001.fits --format fiberassign
"""

SCORE_EXAMPLES = """\b
Examples:
  rfpsurvey score confSummary-26.par.gz
  rfpsurvey score confSummary-26.par.gz --instrument sloanFlatCMM
  rfpsurvey score plan.ecsv --instrument sdss_apo
  rfpsurvey score designs.ecsv --instrument sdss_lco \\
      --set catalog.select.design_id=503246 --set equinox=J2022.0
  rfpsurvey score tile.fits --constraint sky=20/spectrograph
"""

TILE_EXAMPLES = """\b
Examples:
  rfpsurvey tile --region "box 180 240 25 45" --passes 2 --output tiles.ecsv \\
      --report tiles.html
  rfpsurvey tile --region sky --method spiral --instrument desi
  rfpsurvey tile stars.fits --method network_flow --completeness 0.95 \\
      --allocator repair
  rfpsurvey tile stars.fits --method given --centers tiles.ecsv
  rfpsurvey tile stars.fits --region "cap 95 23 5" \\
      --set tiles.declination="[-10, 60]"
  rfpsurvey tile stars.fits --set radius=1.5 --set fibers=400
"""

DESIGN_EXAMPLES = """\b
Examples:
  rfpsurvey design --ratio 1:2:5 --pitch 22:30:9
  rfpsurvey design --instrument mine.toml --plot mine.png
  rfpsurvey design --instrument lamost --spread 0.3 --pitch 24:32:9
  rfpsurvey design --central-arm 7.25:14.5 --ratio 1:2 --pitch 24.6:35 \\
      --n-designs 4096 --plot front.png
  rfpsurvey design --ratio 1:2:5 --estimand allocated --output designs.ecsv \\
      --workers 2
  rfpsurvey design --ratio 1,1.5 --pitch 25:35:5 --estimand collision_free \\
      --targets-per-positioner 1 --workers 2
"""

SURVEY_EXAMPLES = """\b
Examples:
  rfpsurvey survey
  rfpsurvey survey stars.fits --tiles tiles.ecsv --visits 2 --workers 2 \\
      --folder plan --report plan.html
  rfpsurvey survey stars.fits --tiles tiles.ecsv --visits 2 --workers 2 \\
      --folder plan --resume
  rfpsurvey survey stars.fits --allocator repair \\
      --constraint "required 4711" --constraint "keep_out 95.0 23.1 0.01"
  rfpsurvey survey stars.fits --allocator joint --set joint.time_limit=600 \\
      --folder plan
  rfpsurvey survey stars.fits --tiles tiles.ecsv --visits 2 --folder plan \\
      --write-plan plan.toml
  rfpsurvey survey plan.toml --workers 2
  rfpsurvey survey stars.fits --tiles tiles.ecsv --folder plan \\
      --set rule.after_success=4 --set rule.retries=2
  rfpsurvey survey plan --replan --report rest.html
  rfpsurvey survey hats_catalog --tiles tiles.ecsv \\
      --set scheduler=tcp://10.0.0.1:8786 --folder plan
"""

RECORD_EXAMPLES = """\b
Examples:
  rfpsurvey record plan night1.ecsv
  rfpsurvey record plan mtl-done-tiles.ecsv
  rfpsurvey record plan night2.csv --column date=night --enough 0.9
  rfpsurvey record plan confSummaryF-998.par --tile 17
  rfpsurvey record plan new_targets.ecsv
"""

STATUS_EXAMPLES = """\b
Examples:
  rfpsurvey status plan
  rfpsurvey status plan --until 2026-01-31 --output targets.fits
  rfpsurvey status plan --plot status.png --report status.html
"""

DIFF_EXAMPLES = """\b
Examples:
  rfpsurvey diff before plan
  rfpsurvey diff before plan --output changes.ecsv
"""

SELECT_EXAMPLES = """\b
Examples:
  rfpsurvey select --n-realizations 64 --output selection.fits
  rfpsurvey select galaxies.fits --instrument desi --tiles tiles.ecsv \\
      --workers 2 --folder selection
  rfpsurvey select galaxies.fits --instrument desi --tiles tiles.ecsv \\
      --workers 2 --folder selection --resume
  rfpsurvey select galaxies.fits --tiles tiles.ecsv --plot selection.png \\
      --report selection.html
  rfpsurvey select galaxies.fits --tiles tiles.ecsv \\
      --set lost_in_collision=false --output selection.fits
  rfpsurvey select survey_folder --output selection.fits
"""

POTENTIAL_EXAMPLES = """\b
Examples:
  rfpsurvey potential random.fits --instrument desi --tiles tiles.ecsv \\
      --output potential.fits
  rfpsurvey potential random.fits --instrument desi --survey plan \\
      --workers 2 --output potential.fits
"""

BENCHMARK_EXAMPLES = """\b
Examples:
  rfpsurvey benchmark collisions
  rfpsurvey benchmark collisions --instrument sdss_apo --method exact \\
      --method sampled --plot sdss.pdf
  rfpsurvey benchmark batches --instrument moons
  rfpsurvey benchmark probability --instrument moons --plot moons.png
"""

PROBABILITY_EXAMPLES = """\b
Examples:
  rfpsurvey probability lamost
  rfpsurvey probability sdss_apo --method monte_carlo --precision 0.002 \\
      --workers 2
  rfpsurvey probability moons --estimand independent --density shared
  rfpsurvey probability lamost --targets stars.fits --output map.fits \\
      --plot map.png
"""
