!> Fortran tests: `viscovib-tester [SUITE [TEST]]` runs all, one suite, or one
!! test by name. The exit status is 1 if anything failed or nothing was run.
program tester
  use testing, only: report, select_test
  use test_base, only: run_base
  use test_dense, only: run_dense
  use test_eigenvalues, only: run_eigenvalues
  use test_kernels, only: run_kernels
  use test_law_bounds, only: run_law_bounds
  use test_namelist, only: run_namelist
  use test_skips, only: run_skips
  use test_vector_math, only: run_vector_math
  implicit none

  character(len=64) :: suite, name
  logical :: known

  call get_command_argument(1, suite)
  call get_command_argument(2, name)
  call select_test(trim(name))
  known = .false.

  if (wants('base')) call run_base()
  if (wants('dense')) call run_dense()
  if (wants('eigenvalues')) call run_eigenvalues()
  if (wants('kernels')) call run_kernels()
  if (wants('law_bounds')) call run_law_bounds()
  if (wants('namelist')) call run_namelist()
  if (wants('skips')) call run_skips()
  if (wants('vector_math')) call run_vector_math()

  if (.not. known) then
    write (*, '(2a)') 'no suite of this name: ', trim(suite)
    stop 1
  end if
  if (report() > 0) stop 1

contains

  logical function wants(title)
    character(len=*), intent(in) :: title
    wants = suite == '' .or. suite == title
    known = known .or. wants
  end function wants

end program tester
