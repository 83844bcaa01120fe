! Optimize: -O3
!> The equations of harmonic balance of a driven system q'' = a(q, q', cos(p_j t)) on
!! a torus, with their derivatives.
!!
!! For orders k with frequencies w_k = k.omega and unknowns X_k,
!!
!!   R_k = -w_k^2 X_k - A_k,
!!
!! where A are the harmonics of a along the motion, from samples on the torus. The equations use
!! accelerations, so any differentiable system is suitable. The derivatives are exact for the
!! sampled equations: with moments Q, V of da/dq and da/dq', the harmonics of their change are
!!
!!   Y_k = sum_l (Q_(k-l) + i w_l V_(k-l)) dX_l - (Q_(k+l) - i w_l V_(k+l)) conj dX_l.
module viscovib_torus_balance
  use viscovib_constants, only: pi
  use viscovib_curve, only: curve_type
  use viscovib_driven_system, only: differentiable_system_type
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  use viscovib_status, only: status_type
  use viscovib_torus, only: new_torus, torus_type
  implicit none
  private

  public :: torus_balance_type, new_torus_balance

  !> Type of the parameter: a base frequency, the amplitude of a drive, or a factor of all drives.
  integer, parameter, public :: vary_frequency = 1, vary_amplitude = 2, vary_factor = 3

  !> Indices in the torus's list of orders; whether the first one is the mean; whether the orders
  !! have sine parts.
  type :: order_list
    integer, allocatable :: k(:)
    logical :: mean = .false., sine = .true.
  end type order_list

  type, extends(curve_type) :: torus_balance_type
    type(torus_type) :: torus
    !> Base frequencies, shape (n_axes).
    real(wp), allocatable :: omega(:)
    !> Amplitudes of the drives, shape (n_drives), and a common factor.
    real(wp), allocatable :: amplitude(:)
    real(wp) :: factor = 1.0_wp
    !> One of `vary_*`, and the index of the axis or drive.
    integer :: vary = vary_frequency, which = 1
    class(differentiable_system_type), pointer :: system => null()
    !> The drives' angles are drive_orders(:, j).theta, shape (n_axes, n_drives).
    integer, allocatable :: drive_orders(:, :)
    integer, private :: n_dof = 0
    !> Indices of the unknowns x in the full array, shape (torus%n, n_dof), and index of the first
    !! unknown of each coordinate, shape (n_dof + 1).
    integer, allocatable, private :: from(:), first(:)
    !> Orders of each coordinate that are unknowns, shape (n_orders, n_dof).
    logical, allocatable, private :: chosen(:, :)
    logical, private :: even_in_time = .false.
    !> Orders of each coordinate, shape (n_dof).
    type(order_list), allocatable, private :: kept(:)
    !> cos of the drives' angles at the samples, shape (n_samples, n_drives).
    real(wp), allocatable, private :: cosines(:, :)
    !> Coordinates, velocities and the derivative of the velocities with respect to a frequency at
    !! the samples, shape (n_samples, n_dof, 3); accelerations and their change, shape (n_samples,
    !! n_dof, 2); da_i/dq_j and da_i/dq'_j, shape (n_samples, n_dof, 2 n_dof).
    real(wp), allocatable, private :: motion(:, :, :), a(:, :, :), slopes(:, :, :)
    !> Moments of the slopes, allocated at first use.
    complex(wp), allocatable, private :: slope_moments(:, :, :)
  contains
    procedure :: equations
    procedure :: residual
    procedure :: raise_terms
    procedure :: raise_to_inertia
    procedure :: set_parameter
    procedure :: rate
    procedure :: expanded
    procedure :: reduced
    procedure :: visit
    procedure :: mean_slopes
    procedure :: n_unknowns
    procedure :: first_orders
    procedure, private :: defects
    procedure, private :: evaluate
    procedure, private :: add_block
  end type torus_balance_type

contains

  subroutine new_torus_balance(balance, system, torus, drive_orders, omega, amplitude, kept, &
                               even_in_time)
    type(torus_balance_type), intent(out) :: balance
    class(differentiable_system_type), intent(in), target :: system
    type(torus_type), intent(in) :: torus
    integer, intent(in) :: drive_orders(:, :)
    real(wp), intent(in) :: omega(:), amplitude(:)
    !> Orders of each coordinate that are unknowns, shape (n_orders, n_dof); the remaining ones are
    !! 0, for example by a symmetry. Default: all.
    logical, intent(in), optional :: kept(:, :)
    !> Only cosines: motions that are even in time.
    logical, intent(in), optional :: even_in_time
    integer :: d, j

    balance%torus = torus
    balance%system => system
    balance%drive_orders = drive_orders
    balance%omega = omega
    balance%amplitude = amplitude
    d = system%n_dof
    balance%n_dof = d
    call choose_unknowns(balance, kept, even_in_time)
    allocate (balance%cosines(torus%n_samples, size(drive_orders, 2)), source=0.0_wp)
    allocate (balance%motion(torus%n_samples, d, 3), balance%a(torus%n_samples, d, 2))
    do j = 1, size(drive_orders, 2)
      call drive_samples(torus, drive_orders(:, j), balance%cosines(:, j))
    end do
  end subroutine new_torus_balance

  !> Select the unknowns and their indices.
  pure subroutine choose_unknowns(balance, kept, even_in_time)
    type(torus_balance_type), intent(inout) :: balance
    logical, intent(in), optional :: kept(:, :), even_in_time
    logical :: part(balance%torus%n)
    integer :: d, i

    allocate (balance%chosen(size(balance%torus%orders, 2), balance%n_dof), source=.true.)
    if (present(kept)) balance%chosen = kept
    if (present(even_in_time)) balance%even_in_time = even_in_time
    allocate (balance%kept(balance%n_dof), balance%first(balance%n_dof + 1), balance%from(0))
    do d = 1, balance%n_dof
      associate (list => balance%kept(d), chosen => balance%chosen)
        list%k = pack([(i, i=1, size(chosen, 1))], chosen(:, d))
        list%mean = chosen(1, d)
        list%sine = .not. balance%even_in_time
        part(1::2) = chosen(:, d)
        part(2::2) = chosen(2:, d) .and. list%sine
      end associate
      balance%first(d) = size(balance%from) + 1
      balance%from = [balance%from, (d - 1)*balance%torus%n &
                      + pack([(i, i=1, balance%torus%n)], part)]
    end do
    balance%n = size(balance%from)
    balance%first(balance%n_dof + 1) = balance%n + 1
    ! Cosines alone have no phase.
    if (balance%even_in_time) return
    ! A group ends with an imaginary part or a mean: both have odd indices.
    balance%last_of_group = pack([(i, i=1, balance%n)], &
                                 mod(modulo(balance%from - 1, balance%torus%n), 2) == 0)
  end subroutine choose_unknowns

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
    real(wp), dimension(size(self%torus%orders, 2)) :: w, w_slope
    real(wp), dimension(self%torus%n, self%n_dof) :: y, part
    integer :: a, b

    r = 0.0_wp
    slope = 0.0_wp
    call self%visit(x, p, .true., inside)
    if (.not. inside) return
    w = self%torus%frequencies(self%omega)
    w_slope = 0.0_wp
    if (self%vary == vary_frequency) w_slope = self%torus%orders(self%which, :)
    y = self%expanded(x)
    call self%defects(w, y, r)
    do a = 1, self%n_dof
      call self%torus%harmonics(self%a(:, a, 2), part(:, a))
      part(:, a) = -twice(2.0_wp*w*w_slope)*y(:, a) - part(:, a)
    end do
    slope = self%reduced(reshape(part, [size(part)]))
    if (.not. allocated(self%slope_moments)) then
      allocate (self%slope_moments(self%torus%n_moments, self%n_dof, 2*self%n_dof))
    end if
    do b = 1, 2*self%n_dof
      do a = 1, self%n_dof
        call self%torus%moments(self%slopes(:, a, b), self%slope_moments(:, a, b))
      end do
    end do
    do b = 1, self%n_dof
      do a = 1, self%n_dof
        call self%add_block(w, a, b, jacobian)
      end do
    end do
  end subroutine equations

  !> R without derivatives: a third of the transforms and no sums over orders.
  subroutine residual(self, x, p, r, inside)
    class(torus_balance_type), intent(inout) :: self
    real(wp), intent(in) :: x(:), p
    real(wp), intent(out) :: r(:)
    logical, intent(out) :: inside

    r = 0.0_wp
    call self%visit(x, p, .false., inside)
    if (inside) call self%defects(self%torus%frequencies(self%omega), self%expanded(x), r)
  end subroutine residual

  subroutine raise_terms(self, x, p, terms)
    class(torus_balance_type), intent(in) :: self
    real(wp), intent(in) :: x(:), p
    real(wp), intent(inout) :: terms(:)
    integer :: j
    call self%raise_to_inertia([(merge(p, self%omega(j), self%vary == vary_frequency &
                                       .and. j == self%which), j=1, size(self%omega))], x, terms)
  end subroutine raise_terms

  !> Like `raise_by_inertia`, for the orders of each coordinate.
  pure subroutine raise_to_inertia(self, omega, x, terms)
    class(torus_balance_type), intent(in) :: self
    !> Base frequencies.
    real(wp), intent(in) :: omega(:), x(:)
    real(wp), intent(inout) :: terms(:)
    integer :: d
    terms = max(terms, abs(x)*self%reduced([spread(twice(self%torus%frequencies(omega)**2), 2, &
                                                   self%n_dof)]))
    do d = 1, self%n_dof
      associate (i => self%first(d), j => self%first(d + 1) - 1)
        terms(i:j) = maxval(terms(i:j))
      end associate
    end do
  end subroutine raise_to_inertia

  !> -w^2 X - A for the motion of the last evaluation.
  subroutine defects(self, w, y, r)
    class(torus_balance_type), intent(inout) :: self
    real(wp), intent(in) :: w(:), y(:, :)
    real(wp), intent(out) :: r(:)
    real(wp) :: part(self%torus%n, self%n_dof)
    integer :: a
    do a = 1, self%n_dof
      call self%torus%harmonics(self%a(:, a, 1), part(:, a))
      part(:, a) = -twice(w**2)*y(:, a) - part(:, a)
    end do
    r = self%reduced(reshape(part, [size(part)]))
  end subroutine defects

  !> Motion, accelerations and, if requested, their derivatives at the samples.
  subroutine visit(self, x, p, derivatives, inside)
    class(torus_balance_type), intent(inout) :: self
    real(wp), intent(in) :: x(:), p
    logical, intent(in) :: derivatives
    !> False, without a result, if the equations are not defined.
    logical, intent(out) :: inside
    complex(wp), dimension(size(self%torus%orders, 2)) :: turn, one, turn_slope
    real(wp) :: y(self%torus%n, self%n_dof)
    integer :: d

    inside = p > self%lowest
    if (.not. inside) return
    call self%set_parameter(p)
    y = self%expanded(x)
    one = (1.0_wp, 0.0_wp)
    turn = cmplx(0.0_wp, self%torus%frequencies(self%omega), wp)
    do d = 1, self%n_dof
      call self%torus%to_samples(y(:, d), one, self%motion(:, d, 1))
      call self%torus%to_samples(y(:, d), turn, self%motion(:, d, 2))
    end do
    if (derivatives .and. self%vary == vary_frequency) then
      turn_slope = cmplx(0.0_wp, self%torus%orders(self%which, :), wp)
      do d = 1, self%n_dof
        call self%torus%to_samples(y(:, d), turn_slope, self%motion(:, d, 3))
      end do
    end if
    call self%evaluate(inside, derivatives)
  end subroutine visit

  !> Means of the derivatives of the accelerations by coordinates and by velocities, shape (n_dof,
  !! n_dof), along the motion last evaluated with derivatives.
  pure subroutine mean_slopes(self, by_q, by_v)
    class(torus_balance_type), intent(in) :: self
    real(wp), intent(out) :: by_q(:, :), by_v(:, :)
    integer :: a, b
    do b = 1, self%n_dof
      do a = 1, self%n_dof
        by_q(a, b) = sum(self%slopes(:, a, b))/self%torus%n_samples
        by_v(a, b) = sum(self%slopes(:, a, self%n_dof + b))/self%torus%n_samples
      end do
    end do
  end subroutine mean_slopes

  !> Number of unknowns among the first m orders.
  pure integer function n_unknowns(self, m)
    class(torus_balance_type), intent(in) :: self
    integer, intent(in) :: m
    n_unknowns = count(self%chosen(:m, :))
    if (.not. self%even_in_time) n_unknowns = n_unknowns + count(self%chosen(2:m, :))
  end function n_unknowns

  !> The balance of the first m orders, with the corresponding unknowns.
  subroutine first_orders(self, m, few, status)
    class(torus_balance_type), intent(in) :: self
    integer, intent(in) :: m
    type(torus_balance_type), intent(out) :: few
    type(status_type), intent(out) :: status
    type(torus_type) :: torus
    call new_torus(torus, self%torus%orders(:, :m), status)
    if (status%failed()) return
    call new_torus_balance(few, self%system, torus, self%drive_orders, self%omega, &
                           self%amplitude, self%chosen(:m, :), self%even_in_time)
  end subroutine first_orders

  !> Repeat values of the orders for each of their unknowns.
  pure function twice(values) result(each)
    real(wp), intent(in) :: values(:)
    real(wp) :: each(2*size(values) - 1)
    each(1::2) = values
    each(2::2) = values(2:)
  end function twice

  !> All unknowns, with 0 for those not in x, shape (torus%n, n_dof).
  pure function expanded(self, x) result(y)
    class(torus_balance_type), intent(in) :: self
    real(wp), intent(in) :: x(:)
    real(wp) :: y(self%torus%n, self%n_dof), all_of_them(self%torus%n*self%n_dof)
    all_of_them = 0.0_wp
    all_of_them(self%from) = x
    y = reshape(all_of_them, shape(y))
  end function expanded

  !> The inverse of `expanded`.
  pure function reduced(self, y) result(x)
    class(torus_balance_type), intent(in) :: self
    !> Shape (torus%n n_dof).
    real(wp), intent(in) :: y(:)
    real(wp) :: x(self%n)
    x = y(self%from)
  end function reduced

  !> Accelerations at the samples, with all their derivatives if requested, block by block of lanes.
  subroutine evaluate(self, inside, derivatives)
    class(torus_balance_type), intent(inout) :: self
    logical, intent(out) :: inside
    logical, intent(in) :: derivatives
    real(wp), dimension(n_lanes, self%n_dof) :: q, v, dq, dv, a, da
    real(wp), dimension(n_lanes, size(self%cosines, 2)) :: drive, raised
    real(wp) :: scale(size(self%cosines, 2))
    integer :: first, m, d, j

    inside = .true.
    if (derivatives .and. .not. allocated(self%slopes)) then
      allocate (self%slopes(self%torus%n_samples, self%n_dof, 2*self%n_dof))
    end if
    scale = self%factor*self%amplitude
    dq = 0.0_wp
    dv = 0.0_wp
    do first = 1, self%torus%n_samples, n_lanes
      m = min(n_lanes, self%torus%n_samples - first + 1)
      do d = 1, self%n_dof
        call load(m, self%motion(first:first + m - 1, d, 1), q(:, d))
        call load(m, self%motion(first:first + m - 1, d, 2), v(:, d))
      end do
      do j = 1, size(drive, 2)
        call load(m, self%cosines(first:first + m - 1, j), raised(:, j))
        drive(:, j) = scale(j)*raised(:, j)
      end do
      inside = within_range(self%n_dof, self%system%margin(q), q, v)
      if (.not. inside) return
      if (.not. derivatives) then
        call self%system%acceleration(q, v, drive, a)
        call store(first, m, a, self%a(:, :, 1))
        cycle
      end if
      do d = 1, self%n_dof
        dq(:, d) = 1.0_wp
        call self%system%tangent(q, v, drive, dq, dv, a, da)
        call store(first, m, da, self%slopes(:, :, d))
        dq(:, d) = 0.0_wp
        dv(:, d) = 1.0_wp
        call self%system%tangent(q, v, drive, dq, dv, a, da)
        call store(first, m, da, self%slopes(:, :, self%n_dof + d))
        dv(:, d) = 0.0_wp
      end do
      call store(first, m, a, self%a(:, :, 1))
      call along_parameter(self, first, m, q, v, drive, raised, da)
      call store(first, m, da, self%a(:, :, 2))
    end do
  end subroutine evaluate

  !> Change of the accelerations with the parameter, for fixed harmonics of the motion.
  pure subroutine along_parameter(self, first, m, q, v, drive, raised, change)
    class(torus_balance_type), intent(in) :: self
    integer, intent(in) :: first, m
    real(wp), intent(in), dimension(n_lanes, self%n_dof) :: q, v
    real(wp), intent(in), dimension(n_lanes, size(self%cosines, 2)) :: drive, raised
    real(wp), intent(out) :: change(n_lanes, self%n_dof)
    real(wp), dimension(n_lanes, self%n_dof) :: above, below
    real(wp) :: more(n_lanes, size(self%cosines, 2))
    integer :: d, j, last

    if (self%vary == vary_frequency) then
      last = first + m - 1
      change = 0.0_wp
      do d = 1, self%n_dof
        do j = 1, self%n_dof
          change(:m, j) = change(:m, j) + self%slopes(first:last, j, self%n_dof + d) &
                          *self%motion(first:last, d, 3)
        end do
      end do
    else
      ! Loads enter linearly, so that the difference is exact.
      do j = 1, size(more, 2)
        if (self%vary == vary_factor) then
          more(:, j) = self%amplitude(j)*raised(:, j)
        else
          more(:, j) = merge(self%factor*raised(:, j), 0.0_wp*drive(:, j), j == self%which)
        end if
      end do
      call self%system%acceleration(q, v, drive + 0.5_wp*more, above)
      call self%system%acceleration(q, v, drive - 0.5_wp*more, below)
      change = above - below
    end if
  end subroutine along_parameter

  !> Derivatives of the equations of coordinate a by coordinate b, from the moments of the slopes.
  !! The mean is the imaginary part of an order of frequency 0, whose equation is halved.
  pure subroutine add_block(self, w, a, b, jacobian)
    class(torus_balance_type), intent(in) :: self
    real(wp), intent(in) :: w(:)
    integer, intent(in) :: a, b
    real(wp), intent(inout) :: jacobian(:, :)
    complex(wp) :: by_sine, by_cosine, p, q
    integer :: i, j, k, l, t, down, up
    logical :: sine

    associate (rows => self%kept(a), columns => self%kept(b), place => self%torus%place, &
               zero => self%torus%origin, first => self%first(a), d => self%n_dof)
      j = self%first(b) - 1
      do l = 1, size(columns%k)
        k = place(columns%k(l))
        sine = columns%sine .and. .not. (columns%mean .and. l == 1)
        j = j + merge(2, 1, sine)
        t = first
        do i = 1, size(rows%k)
          down = zero + place(rows%k(i)) - k
          up = zero + place(rows%k(i)) + k
          p = self%slope_moments(down, a, b) &
              + cmplx(0.0_wp, w(columns%k(l)), wp)*self%slope_moments(down, a, d + b)
          q = self%slope_moments(up, a, b) &
              - cmplx(0.0_wp, w(columns%k(l)), wp)*self%slope_moments(up, a, d + b)
          by_cosine = cmplx(aimag(p + q), -real(p + q), wp)
          by_sine = q - p
          if (rows%mean .and. i == 1) then
            jacobian(t, j) = 0.5_wp*aimag(by_cosine)
            if (sine) jacobian(t, j - 1) = 0.5_wp*aimag(by_sine)
            t = t + 1
          else if (rows%sine) then
            jacobian(t, j) = real(by_cosine)
            jacobian(t + 1, j) = aimag(by_cosine)
            if (sine) then
              jacobian(t, j - 1) = real(by_sine)
              jacobian(t + 1, j - 1) = aimag(by_sine)
            end if
            t = t + 2
          else
            jacobian(t, j) = aimag(by_cosine)
            t = t + 1
          end if
        end do
        if (a /= b) cycle
        jacobian(j, j) = jacobian(j, j) - w(columns%k(l))**2
        if (sine) jacobian(j - 1, j - 1) = jacobian(j - 1, j - 1) - w(columns%k(l))**2
      end do
    end associate
  end subroutine add_block

  !> An upper bound of the rate at which a perturbation of the motion last evaluated rotates or
  !! grows (rad per unit of time).
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

  ! Samples on a torus: samples of the drives, and copies between samples and lanes.

  !> cos of the angle order.theta at the samples.
  pure subroutine drive_samples(torus, order, cosine)
    type(torus_type), intent(in) :: torus
    integer, intent(in) :: order(:)
    real(wp), intent(out) :: cosine(:)
    complex(wp) :: wave(maxval(torus%n_points), 3), across
    real(wp) :: angle
    integer :: i, j, k, s

    wave = (1.0_wp, 0.0_wp)
    do i = 1, size(order)
      do s = 1, torus%n_points(i)
        angle = 2.0_wp*pi*modulo(order(i)*(s - 1), torus%n_points(i))/torus%n_points(i)
        wave(s, i) = cmplx(cos(angle), sin(angle), wp)
      end do
    end do
    s = 0
    do k = 1, torus%n_points(3)
      do j = 1, torus%n_points(2)
        across = wave(j, 2)*wave(k, 3)
        do i = 1, torus%n_points(1)
          cosine(s + i) = real(wave(i, 1))*real(across) - aimag(wave(i, 1))*aimag(across)
        end do
        s = s + torus%n_points(1)
      end do
    end do
  end subroutine drive_samples

  !> Load a block of lanes; if there are fewer values the last one is repeated.
  pure subroutine load(m, values, lanes)
    integer, intent(in) :: m
    real(wp), intent(in) :: values(m)
    real(wp), intent(out) :: lanes(n_lanes)
    integer :: l
    if (m == n_lanes) then
      do l = 1, n_lanes
        lanes(l) = values(l)
      end do
    else
      lanes(:m) = values
      lanes(m + 1:) = values(m)
    end if
  end subroutine load

  !> Store lanes in their rows of an array of samples.
  pure subroutine store(first, m, lanes, samples)
    integer, intent(in) :: first, m
    !> Shapes (n_lanes, n), of which m lanes are valid, and (n_samples, n).
    real(wp), intent(in) :: lanes(:, :)
    real(wp), intent(inout) :: samples(:, :)
    integer :: d, l
    do d = 1, size(lanes, 2)
      if (m == n_lanes) then
        do l = 1, n_lanes
          samples(first - 1 + l, d) = lanes(l, d)
        end do
      else
        samples(first:first + m - 1, d) = lanes(:m, d)
      end if
    end do
  end subroutine store

  !> True within the range of the equations, and far from overflow.
  pure logical function within_range(n, margin, q, v)
    integer, intent(in) :: n
    real(wp), intent(in) :: margin(n_lanes), q(n_lanes, n), v(n_lanes, n)
    real(wp) :: outside(n_lanes)
    integer :: d, l
    do l = 1, n_lanes
      outside(l) = merge(0.0_wp, 1.0_wp, margin(l) > 0.0_wp)
    end do
    do d = 1, n
      do l = 1, n_lanes
        ! NaN is not within the range either.
        outside(l) = outside(l) + merge(0.0_wp, 1.0_wp, abs(q(l, d)) <= 1.0e6_wp &
                                        .and. abs(v(l, d)) <= 1.0e60_wp)
      end do
    end do
    within_range = maxval(outside) < 0.5_wp
  end function within_range

end module viscovib_torus_balance
