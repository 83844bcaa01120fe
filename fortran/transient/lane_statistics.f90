!> What is learnt from trajectories as they pass, without storing them: one
!! accumulator a lane.
module viscovib_lane_statistics
  use, intrinsic :: ieee_arithmetic, only: ieee_quiet_nan, ieee_value
  use viscovib_constants, only: pi
  use viscovib_kinds, only: i8, wp
  use viscovib_lanes, only: max_dof, n_lanes
  use viscovib_phases, only: split_phase, step_phase
  use viscovib_vector_math, only: sine_cosine_lanes
  implicit none
  private

  public :: moments_type, new_moments, lines_type, new_lines

  !> Largest size, mean and mean square of states.
  type :: moments_type
    integer :: n_dof = 0
    integer(i8) :: n(n_lanes) = 0
    !> Lane, coordinate, and q or v.
    real(wp), dimension(n_lanes, max_dof, 2) :: peak = 0.0_wp, total = 0.0_wp, squares = 0.0_wp
    real(wp), dimension(n_lanes, max_dof, 2), private :: total_rest = 0.0_wp, squares_rest = 0.0_wp
  contains
    procedure :: add => add_moments
    procedure :: means
  end type moments_type

  !> Amplitudes at given frequencies: u = mean + Re(X exp(i omega t)), by
  !! projection under a Hann window over the whole record.
  type :: lines_type
    integer :: n_dof = 0, n = 0
    integer(i8) :: n_samples = 0, i = 0
    real(wp), allocatable, private :: high(:, :), low(:, :), step_high(:, :), step_low(:, :)
    !> Lane; lane and line; lane and coordinate; lane, line and coordinate.
    real(wp), private :: weight(n_lanes) = 0.0_wp, mean(n_lanes, max_dof) = 0.0_wp
    complex(wp), allocatable, private :: empty(:, :), sums(:, :, :)
  contains
    procedure :: add => add_lines
    procedure :: amplitudes
  end type lines_type

contains

  pure subroutine new_moments(moments, n_dof)
    type(moments_type), intent(out) :: moments
    integer, intent(in) :: n_dof
    moments%n_dof = n_dof
  end subroutine new_moments

  !> Take in a sample; lanes that stand still are left out.
  pure subroutine add_moments(self, q, v, alive)
    class(moments_type), intent(inout) :: self
    real(wp), intent(in) :: q(n_lanes, *), v(n_lanes, *)
    logical, intent(in) :: alive(n_lanes)
    real(wp) :: weight(n_lanes)
    integer :: d

    weight = merge(1.0_wp, 0.0_wp, alive)
    self%n = self%n + nint(weight, i8)
    do d = 1, self%n_dof
      call add_one(q(1, d), weight, self%peak(:, d, 1), self%total(:, d, 1), &
                   self%squares(:, d, 1), self%total_rest(:, d, 1), self%squares_rest(:, d, 1))
      call add_one(v(1, d), weight, self%peak(:, d, 2), self%total(:, d, 2), &
                   self%squares(:, d, 2), self%total_rest(:, d, 2), self%squares_rest(:, d, 2))
    end do
  end subroutine add_moments

  !> One coordinate, in compensated summation.
  pure subroutine add_one(x, weight, peak, total, squares, total_rest, squares_rest)
    real(wp), intent(in) :: x(n_lanes), weight(n_lanes)
    real(wp), dimension(n_lanes), intent(inout) :: peak, total, squares, total_rest, squares_rest
    real(wp) :: part, new
    integer :: l
    !GCC$ unroll 1
    do l = 1, n_lanes
      part = weight(l)*x(l) + total_rest(l)
      new = total(l) + part
      total_rest(l) = part - (new - total(l))
      total(l) = new
      part = weight(l)*x(l)**2 + squares_rest(l)
      new = squares(l) + part
      squares_rest(l) = part - (new - squares(l))
      squares(l) = new
      part = weight(l)*abs(x(l))
      if (part > peak(l)) peak(l) = part
    end do
  end subroutine add_one

  !> Mean and root of the mean square, shape (n_lanes, n_dof, 2); without a sample these
  !! and the peak are NaN.
  pure subroutine means(self, mean, rms)
    class(moments_type), intent(inout) :: self
    real(wp), intent(out) :: mean(:, :, :), rms(:, :, :)
    integer :: l
    do l = 1, n_lanes
      if (self%n(l) == 0) then
        self%peak(l, :, :) = ieee_value(1.0_wp, ieee_quiet_nan)
        mean(l, :, :) = ieee_value(1.0_wp, ieee_quiet_nan)
        rms(l, :, :) = ieee_value(1.0_wp, ieee_quiet_nan)
        cycle
      end if
      mean(l, :, :) = self%total(l, :self%n_dof, :)/self%n(l)
      rms(l, :, :) = sqrt(self%squares(l, :self%n_dof, :)/self%n(l))
    end do
  end subroutine means

  !> Lines at circular frequencies omega from samples at start + i step, i = 0
  !! ... n_samples - 1; step differs from lane to lane.
  pure subroutine new_lines(lines, n_dof, omega, start, step, n_samples)
    type(lines_type), intent(out) :: lines
    integer, intent(in) :: n_dof
    real(wp), intent(in) :: omega(:), start(n_lanes), step(n_lanes)
    integer(i8), intent(in) :: n_samples
    integer :: n

    n = size(omega)
    lines%n_dof = n_dof
    lines%n = n
    lines%n_samples = n_samples
    allocate (lines%high(n_lanes, n), lines%low(n_lanes, n))
    allocate (lines%step_high(n_lanes, n), lines%step_low(n_lanes, n))
    call split_phase(spread(omega, 1, n_lanes), spread(start, 2, n), lines%high, lines%low)
    call split_phase(spread(omega, 1, n_lanes), spread(step, 2, n), lines%step_high, &
                     lines%step_low)
    allocate (lines%empty(n_lanes, n), lines%sums(n_lanes, n, n_dof), source=(0.0_wp, 0.0_wp))
  end subroutine new_lines

  pure subroutine add_lines(self, q, alive)
    class(lines_type), intent(inout) :: self
    real(wp), intent(in) :: q(n_lanes, *)
    logical, intent(in) :: alive(n_lanes)
    real(wp) :: window(n_lanes), s(n_lanes), c(n_lanes)
    complex(wp) :: turned(n_lanes)
    integer :: j, d

    ! The window vanishes one sample before the first and one after the last.
    window = merge(sin(pi*real(self%i + 1, wp)/real(self%n_samples + 1, wp))**2, 0.0_wp, alive)
    self%i = self%i + 1
    self%weight = self%weight + window
    do d = 1, self%n_dof
      self%mean(:, d) = self%mean(:, d) + window*q(:, d)
    end do
    do j = 1, self%n
      call sine_cosine_lanes(self%high(:, j), s, c)
      turned = window*cmplx(c - s*self%low(:, j), -(s + c*self%low(:, j)), wp)
      self%empty(:, j) = self%empty(:, j) + turned
      do d = 1, self%n_dof
        self%sums(:, j, d) = self%sums(:, j, d) + q(:, d)*turned
      end do
    end do
    call step_phase(self%high, self%low, self%step_high, self%step_low)
  end subroutine add_lines

  !> X, shape (n_lanes, n, n_dof), the leakage of the mean taken out.
  pure function amplitudes(self) result(x)
    class(lines_type), intent(in) :: self
    complex(wp) :: x(n_lanes, self%n, self%n_dof)
    integer :: l, d
    do d = 1, self%n_dof
      do l = 1, n_lanes
        if (self%weight(l) > 0.0_wp) then
          x(l, :, d) = 2.0_wp*(self%sums(l, :, d) &
                               - self%mean(l, d)/self%weight(l)*self%empty(l, :))/self%weight(l)
        else
          x(l, :, d) = (0.0_wp, 0.0_wp)
        end if
      end do
    end do
  end function amplitudes

end module viscovib_lane_statistics
