!> Grids, numbers in messages, checks.
module test_base
  use testing, only: begin, check, check_close, check_fails, check_ok
  use viscovib_checks, only: check_increasing, check_positive
  use viscovib_files, only: stem
  use viscovib_grids, only: linear_grid, log_grid
  use viscovib_kinds, only: wp
  use viscovib_status, only: show, status_type
  implicit none
  private

  public :: run_base

contains

  subroutine run_base()
    type(status_type) :: status
    real(wp) :: grid(5)

    if (begin('numbers look as one would write them')) then
      call check(show(0.078_wp) == '0.078', show(0.078_wp))
      call check(show(-0.5_wp) == '-0.5', show(-0.5_wp))
      call check(show(0.0_wp) == '0', show(0.0_wp))
      call check(show(1.0e-300_wp) == '1e-300', show(1.0e-300_wp))
      call check(show(0.1_wp + 0.2_wp) == '0.30000000000000004', show(0.1_wp + 0.2_wp))
      call check(show(12) == '12', show(12))
    end if

    if (begin('grids end where they should')) then
      grid = linear_grid(0.1_wp, 0.7_wp, 5)
      call check_close(grid(1), 0.1_wp, 0.0_wp, 'first')
      call check_close(grid(5), 0.7_wp, 0.0_wp, 'last')
      call check_close(grid(3), 0.4_wp, 1.0e-15_wp, 'middle')
      grid = log_grid(1.0e-2_wp, 1.0e2_wp, 5)
      call check_close(grid(5), 1.0e2_wp, 0.0_wp, 'last')
      call check_close(grid(3), 1.0_wp, 1.0e-15_wp, 'middle')
    end if

    if (begin('checks name the value')) then
      call check_positive('mass', 0.0_wp, status)
      call check_fails(status, 'mass = 0: must be greater than 0')
      call check_increasing('t', [1.0_wp, 2.0_wp, 2.0_wp], status)
      call check_fails(status, 't (value 3) = 2 after 2')
      call check_increasing('t', [1.0_wp, 2.0_wp], status)
      call check_ok(status)
    end if

    if (begin('stem of a path')) then
      call check(stem('a/b.c/d.e.nml') == 'd.e', stem('a/b.c/d.e.nml'))
      call check(stem('scene') == 'scene', stem('scene'))
    end if
  end subroutine run_base

end module test_base
