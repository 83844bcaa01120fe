!> Tools for ensemble tasks: fill and read a block of vector lanes.
module viscovib_ensemble_tools
  use, intrinsic :: iso_c_binding, only: c_double, c_double_complex, c_int
  use viscovib_ensemble, only: ensemble_block
  use viscovib_lanes, only: n_lanes
  implicit none
  private

  public :: fill_block, empty_block

contains

  !> Fill a block with the runs from `first` on. Lanes past the last run repeat it.
  subroutine fill_block(block, first, n_drives, n_points, initial, h, sections)
    type(ensemble_block), intent(out) :: block
    !> Number of load frequencies, and of section points.
    integer, intent(in) :: first, n_drives, n_points
    !> Alternating displacements and velocities, and step sizes; one column per run.
    real(c_double), intent(in) :: initial(:, :), h(:)
    !> Previous sections of all runs; size 0 if sections are not requested.
    real(c_double), intent(in) :: sections(:, :, :)
    integer :: d, i, l

    d = size(initial, 1)/2
    allocate (block%q(n_lanes, d), block%v(n_lanes, d), block%frequencies(n_lanes, n_drives))
    allocate (block%sections(n_lanes, 2*d, n_points))
    do l = 1, n_lanes
      i = min(first + l - 1, size(h))
      block%q(l, :) = initial(1::2, i)
      block%v(l, :) = initial(2::2, i)
      block%h(l) = h(i)
      if (size(sections, 3) > 0) block%sections(l, :, :) = sections(:, :, i)
    end do
  end subroutine fill_block

  !> Copy the results of a block to the runs from `first` on. Results not requested have no columns.
  subroutine empty_block(block, first, state, ended, t_reached, peak, mean, rms, amplitudes, &
                         sections, lyapunov, lyapunov_error)
    type(ensemble_block), intent(in) :: block
    integer, intent(in) :: first
    real(c_double), intent(inout), dimension(:, :) :: state, peak, mean, rms
    real(c_double), intent(inout), dimension(:, :) :: lyapunov, lyapunov_error
    integer(c_int), intent(inout) :: ended(:)
    real(c_double), intent(inout) :: t_reached(:), sections(:, :, :)
    complex(c_double_complex), intent(inout) :: amplitudes(:, :, :)
    integer :: i, l

    do l = 1, min(n_lanes, size(ended) - first + 1)
      i = first + l - 1
      state(1::2, i) = block%q(l, :)
      state(2::2, i) = block%v(l, :)
      ended(i) = block%outcome(l)
      t_reached(i) = block%t_reached(l)
      if (size(peak, 2) > 0) then
        call put_moments(block%peak(l, :, :), peak(:, i))
        call put_moments(block%mean(l, :, :), mean(:, i))
        call put_moments(block%rms(l, :, :), rms(:, i))
      end if
      if (size(amplitudes, 2) > 0) amplitudes(:, :, i) = transpose(block%lines(l, :, :))
      if (size(sections, 3) > 0) sections(:, :, i) = block%sections(l, :, :)
      if (size(lyapunov, 1) > 0) then
        lyapunov(:, i) = block%lyapunov(l, :)
        lyapunov_error(:, i) = block%lyapunov_error(l, :)
      end if
    end do
  end subroutine empty_block

  !> Interleave the values of displacements and velocities.
  pure subroutine put_moments(of_block, of_run)
    real(c_double), intent(in) :: of_block(:, :)
    real(c_double), intent(inout) :: of_run(:)
    of_run(1::2) = of_block(:, 1)
    of_run(2::2) = of_block(:, 2)
  end subroutine put_moments

end module viscovib_ensemble_tools
