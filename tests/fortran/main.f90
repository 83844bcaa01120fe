!> Fortran tests: `viscovib-tester [SUITE [TEST]]` runs all, one suite, or one
!! test by name. The exit status is 1 if anything failed or nothing was run.
program tester
  use testing, only: report, select_test
  use test_balance, only: run_balance
  use test_base, only: run_base
  use test_dense, only: run_dense
  use test_floquet, only: run_floquet
  use test_fourier, only: run_fourier
  use test_harmonics, only: run_harmonics
  use test_hereditary, only: run_hereditary_suite
  use test_kernels, only: run_kernels
  use test_law_bounds, only: run_law_bounds
  use test_namelist, only: run_namelist
  use test_polynomial, only: run_polynomial
  use test_roots, only: run_roots
  use test_skips, only: run_skips
  use test_structure_march, only: run_structure_march
  use test_table, only: run_table
  use test_torus, only: run_torus
  use test_transient, only: run_transient
  implicit none

  character(len=64) :: suite, name
  logical :: known

  call get_command_argument(1, suite)
  call get_command_argument(2, name)
  call select_test(trim(name))
  known = .false.

  if (wants('balance')) call run_balance()
  if (wants('base')) call run_base()
  if (wants('dense')) call run_dense()
  if (wants('floquet')) call run_floquet()
  if (wants('fourier')) call run_fourier()
  if (wants('harmonics')) call run_harmonics()
  if (wants('hereditary')) call run_hereditary_suite()
  if (wants('kernels')) call run_kernels()
  if (wants('law_bounds')) call run_law_bounds()
  if (wants('namelist')) call run_namelist()
  if (wants('polynomial')) call run_polynomial()
  if (wants('roots')) call run_roots()
  if (wants('skips')) call run_skips()
  if (wants('structure_march')) call run_structure_march()
  if (wants('table')) call run_table()
  if (wants('torus')) call run_torus()
  if (wants('transient')) call run_transient()

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
