!> The equations of harmonic balance of a driven system q'' = a(q, q', cos(p_j t)) on
!! a torus, with their derivatives.
!!
!! For orders k with frequencies w_k = k.omega and unknowns X_k,
!!
!!   R_k = -w_k^2 X_k - A_k,
!!
!! A being the harmonics of a along the motion, from samples on the torus. The
!! accelerations stand solved for, so that any differentiable system serves as it is.
!! The derivatives are exact ones of the sampled equations: with the moments Q, V of
!! da/dq and da/dq', the harmonics of their change are
!!
!!   Y_k = sum_l (Q_(k-l) + i w_l V_(k-l)) dX_l - (Q_(k+l) - i w_l V_(k+l)) conj dX_l.
module viscovib_torus_balance
  use viscovib_curve, only: curve_type
  use viscovib_driven_system, only: differentiable_system_type
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  use viscovib_torus, only: torus_type
  implicit none
  private

  public :: torus_balance_type, new_torus_balance

  !> What the parameter is: a base frequency; the amplitude of a drive; a factor of
  !! all of them.
  integer, parameter, public :: vary_frequency = 1, vary_amplitude = 2, vary_factor = 3

  type, extends(curve_type) :: torus_balance_type
    type(torus_type) :: torus
    !> Base frequencies, shape (n_axes).
    real(wp), allocatable :: omega(:)
    !> Factors of the drives, shape (n_drives), and one of all.
    real(wp), allocatable :: amplitude(:)
    real(wp) :: factor = 1.0_wp
    !> One of `vary_*`, and of which axis or drive.
    integer :: vary = vary_frequency, which = 1
    class(differentiable_system_type), pointer :: system => null()
    !> The drives' angles are drive_orders(:, j).theta, shape (n_axes, n_drives).
    integer, allocatable :: drive_orders(:, :)
    integer, private :: n_dof = 0
    !> Where in x an order of a coordinate begins, 0 if it is left out, shape
    !! (n_orders, n_dof).
    integer, allocatable, private :: at(:, :)
    !> cos of the drives' angles at the samples, shape (n_samples, n_drives).
    real(wp), allocatable, private :: cosines(:, :)
    !> At the samples coordinates, velocities and the derivative of these with respect
    !! to a frequency, shape (n_samples, n_dof, 3); accelerations and a change of them,
    !! shape (n_samples, n_dof, 2); da_i/dq_j and da_i/dq'_j, shape (n_samples, n_dof,
    !! 2 n_dof).
    real(wp), allocatable, private :: motion(:, :, :), a(:, :, :), slopes(:, :, :)
    !> Moments of the latter two.
    complex(wp), allocatable, private :: a_moments(:, :, :), slope_moments(:, :, :)
  contains
    procedure :: equations
    procedure :: set_parameter
    procedure :: rate
    procedure :: expanded
    procedure :: reduced
    procedure, private :: evaluate
    procedure, private :: add_block
  end type torus_balance_type

contains

  subroutine new_torus_balance(balance, system, torus, drive_orders, omega, amplitude, kept)
    type(torus_balance_type), intent(out) :: balance
    class(differentiable_system_type), intent(in), target :: system
    type(torus_type), intent(in) :: torus
    integer, intent(in) :: drive_orders(:, :)
    real(wp), intent(in) :: omega(:), amplitude(:)
    !> Which orders of which coordinates are unknowns, shape (n_orders, n_dof); the
    !! others are 0, as a symmetry may have it. All, if absent.
    logical, intent(in), optional :: kept(:, :)
    real(wp) :: unit(3)
    integer :: d, j, k, s, rest, place(3)

    balance%torus = torus
    balance%system => system
    balance%drive_orders = drive_orders
    balance%omega = omega
    balance%amplitude = amplitude
    d = system%n_dof
    balance%n_dof = d
    allocate (balance%at(size(torus%orders, 2), d), source=0)
    balance%n = 0
    do j = 1, d
      do k = 1, size(torus%orders, 2)
        if (present(kept)) then
          if (.not. kept(k, j)) cycle
        end if
        balance%at(k, j) = balance%n + 1
        balance%n = balance%n + merge(1, 2, k == 1)
      end do
    end do
    allocate (balance%cosines(torus%n_samples, size(drive_orders, 2)), source=0.0_wp)
    allocate (balance%motion(torus%n_samples, d, 3), balance%a(torus%n_samples, d, 2), &
              balance%slopes(torus%n_samples, d, 2*d), source=0.0_wp)
    allocate (balance%a_moments(torus%n_moments, d, 2), &
              balance%slope_moments(torus%n_moments, d, 2*d), source=(0.0_wp, 0.0_wp))
    unit = 2.0_wp*acos(-1.0_wp)/torus%n_points
    do s = 1, torus%n_samples
      rest = s - 1
      do j = 1, 3
        place(j) = modulo(rest, torus%n_points(j))
        rest = rest/torus%n_points(j)
      end do
      do j = 1, size(drive_orders, 2)
        balance%cosines(s, j) = cos(sum(modulo(drive_orders(:, j)*place(:torus%n_axes), &
                                               torus%n_points(:torus%n_axes)) &
                                        *unit(:torus%n_axes)))
      end do
    end do
  end subroutine new_torus_balance

  pure subroutine set_parameter(self, p)
    class(torus_balance_type), intent(inout) :: self
    real(wp), intent(in) :: p
    select case (self%vary)
    case (vary_frequency)
      self%omega(self%which) = p
    case (vary_amplitude)
      self%amplitude(self%which) = p
    case default
      self%factor = p
    end select
  end subroutine set_parameter

  subroutine equations(self, x, p, r, jacobian, slope, inside)
    class(torus_balance_type), intent(inout) :: self
    real(wp), intent(in) :: x(:), p
    real(wp), intent(out) :: r(:)
    real(wp), intent(inout) :: jacobian(:, :)
    real(wp), intent(out) :: slope(:)
    logical, intent(out) :: inside
    complex(wp) :: factors(size(self%torus%orders, 2), self%n_dof, 3)
    real(wp) :: w(size(self%torus%orders, 2)), w_slope(size(self%torus%orders, 2))
    real(wp) :: y(self%torus%n, self%n_dof, 3), part(self%torus%n)
    integer :: a, b

    r = 0.0_wp
    slope = 0.0_wp
    inside = p > self%lowest
    if (.not. inside) return
    call self%set_parameter(p)
    w = self%torus%frequencies(self%omega)
    w_slope = 0.0_wp
    if (self%vary == vary_frequency) w_slope = self%torus%orders(self%which, :)
    factors(:, :, 1) = (1.0_wp, 0.0_wp)
    factors(:, :, 2) = spread(cmplx(0.0_wp, w, wp), 2, self%n_dof)
    factors(:, :, 3) = spread(cmplx(0.0_wp, w_slope, wp), 2, self%n_dof)
    y = spread(self%expanded(x), 3, 3)
    call self%torus%to_samples(3*self%n_dof, y, factors, self%motion)
    call self%evaluate(inside)
    if (.not. inside) return
    call self%torus%moments(2*self%n_dof, self%a, self%a_moments)
    do a = 1, self%n_dof
      call self%torus%to_unknowns(self%a_moments(:, a, 1), part)
      call put(self%at(:, a), w**2, y(:, a, 1), part, r)
      call self%torus%to_unknowns(self%a_moments(:, a, 2), part)
      call put(self%at(:, a), 2.0_wp*w*w_slope, y(:, a, 1), part, slope)
    end do
    call self%torus%moments(2*self%n_dof**2, self%slopes, self%slope_moments)
    do b = 1, self%n_dof
      do a = 1, self%n_dof
        call self%add_block(w, a, b, jacobian)
      end do
    end do
  end subroutine equations

  !> -factor_k X_k - A_k at the places of a coordinate.
  pure subroutine put(at, factor, x, a, r)
    integer, intent(in) :: at(:)
    real(wp), intent(in) :: factor(:), x(:), a(:)
    real(wp), intent(inout) :: r(:)
    integer :: k
    if (at(1) > 0) r(at(1)) = -factor(1)*x(1) - a(1)
    do k = 2, size(at)
      if (at(k) > 0) r(at(k):at(k) + 1) = -factor(k)*x(2*k - 2:2*k - 1) - a(2*k - 2:2*k - 1)
    end do
  end subroutine put

  !> The unknowns with those left out as 0, shape (torus%n, n_dof).
  pure function expanded(self, x) result(y)
    class(torus_balance_type), intent(in) :: self
    real(wp), intent(in) :: x(:)
    real(wp) :: y(self%torus%n, self%n_dof)
    integer :: d, k
    y = 0.0_wp
    do d = 1, self%n_dof
      if (self%at(1, d) > 0) y(1, d) = x(self%at(1, d))
      do k = 2, size(self%at, 1)
        if (self%at(k, d) > 0) y(2*k - 2:2*k - 1, d) = x(self%at(k, d):self%at(k, d) + 1)
      end do
    end do
  end function expanded

  !> The way back.
  pure function reduced(self, y) result(x)
    class(torus_balance_type), intent(in) :: self
    !> Shape (torus%n n_dof).
    real(wp), intent(in) :: y(:)
    real(wp) :: x(self%n)
    integer :: d, k, from
    do d = 1, self%n_dof
      from = (d - 1)*self%torus%n
      if (self%at(1, d) > 0) x(self%at(1, d)) = y(from + 1)
      do k = 2, size(self%at, 1)
        associate (i => self%at(k, d))
          if (i > 0) x(i:i + 1) = y(from + 2*k - 2:from + 2*k - 1)
        end associate
      end do
    end do
  end function reduced

  !> Accelerations and all their derivatives at the samples, a block of lanes after
  !! another.
  subroutine evaluate(self, inside)
    class(torus_balance_type), intent(inout) :: self
    logical, intent(out) :: inside
    real(wp), dimension(n_lanes, self%n_dof) :: q, v, dq, dv, a, da, above
    real(wp), dimension(n_lanes, size(self%cosines, 2)) :: drive, raised
    integer :: first, last, m, d, j

    inside = .true.
    do first = 1, self%torus%n_samples, n_lanes
      last = min(first + n_lanes - 1, self%torus%n_samples)
      m = last - first + 1
      do d = 1, self%n_dof
        q(:m, d) = self%motion(first:last, d, 1)
        v(:m, d) = self%motion(first:last, d, 2)
        q(m + 1:, d) = self%motion(last, d, 1)
        v(m + 1:, d) = self%motion(last, d, 2)
      end do
      do j = 1, size(drive, 2)
        raised(:m, j) = self%cosines(first:last, j)
        raised(m + 1:, j) = self%cosines(last, j)
        drive(:, j) = self%factor*self%amplitude(j)*raised(:, j)
      end do
      inside = all(self%system%margin(q) > 0.0_wp) .and. all(abs(q) <= 1.0e6_wp) &
               .and. all(abs(v) <= 1.0e60_wp)
      if (.not. inside) return
      do d = 1, self%n_dof
        dq = 0.0_wp
        dv = 0.0_wp
        dq(:, d) = 1.0_wp
        call self%system%tangent(q, v, drive, dq, dv, a, da)
        self%slopes(first:last, :, d) = da(:m, :)
        dq(:, d) = 0.0_wp
        dv(:, d) = 1.0_wp
        call self%system%tangent(q, v, drive, dq, dv, a, da)
        self%slopes(first:last, :, self%n_dof + d) = da(:m, :)
      end do
      self%a(first:last, :, 1) = a(:m, :)
      if (self%vary == vary_frequency) then
        da = 0.0_wp
        do d = 1, self%n_dof
          do j = 1, self%n_dof
            da(:m, j) = da(:m, j) + self%slopes(first:last, j, self%n_dof + d) &
                        *self%motion(first:last, d, 3)
          end do
        end do
      else
        ! Loads enter linearly, so that a difference is no approximation.
        if (self%vary == vary_factor) then
          do j = 1, size(drive, 2)
            raised(:, j) = self%amplitude(j)*raised(:, j)
          end do
        else
          do j = 1, size(drive, 2)
            raised(:, j) = merge(self%factor*raised(:, j), 0.0_wp*drive(:, j), j == self%which)
          end do
        end if
        call self%system%acceleration(q, v, drive + 0.5_wp*raised, above)
        call self%system%acceleration(q, v, drive - 0.5_wp*raised, da)
        da = above - da
      end if
      self%a(first:last, :, 2) = da(:m, :)
    end do
  end subroutine evaluate

  !> Derivatives of the equations of coordinate a by coordinate b, from the moments
  !! of the slopes.
  pure subroutine add_block(self, w, a, b, jacobian)
    class(torus_balance_type), intent(in) :: self
    real(wp), intent(in) :: w(:)
    integer, intent(in) :: a, b
    real(wp), intent(inout) :: jacobian(:, :)
    complex(wp) :: p, q, change
    integer :: i, j, k, l

    associate (zero => self%torus%origin, place => self%torus%place, at => self%at, &
               by_q => self%slope_moments(:, a, b), &
               by_v => self%slope_moments(:, a, self%n_dof + b))
      j = at(1, b)
      if (j > 0) then
        if (at(1, a) > 0) jacobian(at(1, a), j) = -real(by_q(zero))
        do k = 2, size(w)
          i = at(k, a)
          if (i == 0) cycle
          change = 2.0_wp*(0.0_wp, 1.0_wp)*by_q(zero + place(k))
          jacobian(i, j) = -real(change)
          jacobian(i + 1, j) = -aimag(change)
        end do
      end if
      do l = 2, size(w)
        j = at(l, b)
        if (j == 0) cycle
        if (at(1, a) > 0) then
          p = by_q(zero - place(l)) + cmplx(0.0_wp, w(l), wp)*by_v(zero - place(l))
          jacobian(at(1, a), j) = -aimag(p)
          jacobian(at(1, a), j + 1) = -real(p)
        end if
        do k = 2, size(w)
          i = at(k, a)
          if (i == 0) cycle
          p = by_q(zero + place(k) - place(l)) &
              + cmplx(0.0_wp, w(l), wp)*by_v(zero + place(k) - place(l))
          q = by_q(zero + place(k) + place(l)) &
              - cmplx(0.0_wp, w(l), wp)*by_v(zero + place(k) + place(l))
          jacobian(i, j) = real(q) - real(p)
          jacobian(i + 1, j) = aimag(q) - aimag(p)
          jacobian(i, j + 1) = aimag(p) + aimag(q)
          jacobian(i + 1, j + 1) = -real(p) - real(q)
        end do
        if (a == b) then
          jacobian(j, j) = jacobian(j, j) - w(l)**2
          jacobian(j + 1, j + 1) = jacobian(j + 1, j + 1) - w(l)**2
        end if
      end do
    end associate
  end subroutine add_block

  !> An upper bound of how fast a disturbance of the motion seen last can turn or
  !! grow (rad a unit of time).
  pure real(wp) function rate(self)
    class(torus_balance_type), intent(in) :: self
    real(wp) :: by_q, by_v
    integer :: s, a
    rate = 0.0_wp
    do s = 1, self%torus%n_samples
      by_q = 0.0_wp
      by_v = 0.0_wp
      do a = 1, self%n_dof
        by_q = max(by_q, sum(abs(self%slopes(s, a, :self%n_dof))))
        by_v = max(by_v, sum(abs(self%slopes(s, a, self%n_dof + 1:))))
      end do
      rate = max(rate, sqrt(by_q) + by_v)
    end do
  end function rate

end module viscovib_torus_balance
