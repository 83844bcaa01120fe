!> A family of free motions of a driven system without losses and loads, followed along
!! its amplitude or energy, with Floquet multipliers.
module viscovib_free_family
  use, intrinsic :: ieee_arithmetic, only: ieee_is_finite
  use viscovib_curve_branch, only: curve_branch_type, curve_completed, curve_options, follow_curve
  use viscovib_driven_system, only: differentiable_system_type
  use viscovib_free_curve, only: free_curve_type, new_free_curve
  use viscovib_free_orders, only: first_chosen, order_search
  use viscovib_kinds, only: wp
  use viscovib_orbit_floquet, only: orbit_floquet_type
  use viscovib_sized_curve, only: refitted
  use viscovib_status, only: fail, show, status_input_error, status_type
  use viscovib_stopping, only: is_set
  use viscovib_torus, only: new_torus, torus_type
  implicit none
  private

  public :: check_begun, follow_family, free_family_type, free_options

  !> Multipliers larger than this grow. Multipliers of free motions come in pairs about the unit
  !! circle; where two meet, their error is the root of the rounding error.
  real(wp), parameter, public :: free_circle = 1.0_wp + 1.0e-6_wp

  type :: free_options
    !> Orders of each coordinate that are unknowns: a pattern that repeats from order 0 on, shape
    !! (period, n_dof).
    logical, allocatable :: pattern(:, :)
    !> Highest order in multiples of the mode's frequency, which is `order` times the base
    !! frequency; it is increased up to `most` if the tolerance requires.
    integer :: highest = first_chosen, most = first_chosen
    !> Base frequency of small motions.
    real(wp) :: unit = 1.0_wp
    !> The amplitude is that of order `order` of coordinate `dof`; dof = 0: energy.
    integer :: dof = 0, order = 1
    type(curve_options) :: curve
    logical :: stability = .true.
    !> Whether `highest` is adapted; linear mode, counted from 0, and its cosines; whether only
    !! motions with its symmetry are kept.
    logical :: chosen = .true., symmetric = .false.
    integer :: mode = 0
    real(wp), allocatable :: begin(:)
  contains
    procedure :: kept
  end type free_options

  !> Results at n points. Cosine coefficients of all orders, shape (n_orders n_dof).
  type :: free_family_type
    integer :: outcome = curve_completed
    !> Highest order of the mode's frequency, all orders of the base frequency, and the truncation
    !! error of each point, shape (n).
    integer :: highest = 0
    integer, allocatable :: orders(:)
    real(wp), allocatable :: truncation(:)
    !> Error of each point by the last correction and by rounding: at its value of the parameter,
    !! and as distance from the curve, shape (n).
    real(wp), allocatable :: error(:), off(:)
    !> Shape (n); cosine coefficients, shape (n_orders n_dof, n).
    real(wp), allocatable :: parameter(:), nu(:), energy(:), x(:, :)
    !> Largest first, NaN if unknown, shape (2 n_dof, n); not allocated if not requested.
    complex(wp), allocatable :: multipliers(:, :)
    !> Parameters at folds, and their errors.
    real(wp), allocatable :: folds(:), fold_errors(:)
    !> Branch points: parameter, frequency, cosine coefficients, direction in (coefficients,
    !! frequency, parameter), and the last point before each.
    real(wp), allocatable :: branch_p(:), branch_nu(:), branch_x(:, :), across(:, :)
    integer, allocatable :: branch_before(:)
  end type free_family_type

contains

  !> True where an order up to `highest` of the base frequency is an unknown.
  pure function kept(self, highest)
    class(free_options), intent(in) :: self
    integer, intent(in) :: highest
    logical :: kept(highest + 1, size(self%pattern, 2))
    integer :: k
    kept = self%pattern([(mod(k, size(self%pattern, 1)) + 1, k=0, highest)], :)
  end function kept

  !> Start near the cosines `begin`, which are only scaled to the initial size; or, with `along`, at
  !! the cosines `begin` with frequency begin_nu and size begin_p, in that direction (cosines,
  !! frequency, size). `begin` contains the orders up to options%highest.
  subroutine follow_family(family, system, options, begin, status, cancel, begin_nu, begin_p, along)
    type(free_family_type), intent(out) :: family
    !> System without damping; its loads are ignored.
    class(differentiable_system_type), intent(in), target :: system
    type(free_options), intent(in) :: options
    real(wp), intent(in) :: begin(:)
    type(status_type), intent(out) :: status
    !> May be set by another thread to cancel the computation.
    integer, intent(inout), optional :: cancel
    real(wp), intent(in), optional :: begin_nu, begin_p, along(:)
    type(free_curve_type) :: curve
    type(curve_branch_type) :: branch
    type(order_search) :: search
    real(wp), allocatable :: x(:), direction(:)
    integer :: n
    logical :: again

    search%highest = options%highest
    search%most = options%most
    search%tolerance = options%curve%tolerance
    x = begin
    if (present(along)) direction = along
    do
      call new_curve_of(curve, system, options, search%highest*options%order, status)
      if (status%failed()) return
      call follow_once(curve, options, x, branch, cancel, begin_nu, begin_p, direction)
      call end_with_numbers(curve, branch)
      family%highest = search%highest
      call check(curve, system, options, search, branch, again, status, cancel)
      if (status%failed()) return
      if (.not. again) exit
      n = (search%highest*options%order + 1)*system%n_dof
      if (present(along)) direction = [refitted(system%n_dof, direction(:size(x)), n), &
                                       direction(size(x) + 1:)]
      x = refitted(system%n_dof, x, n)
    end do
    call branch%end_resolved()
    family%orders = curve%motion%torus%orders(1, :)
    call keep(family, curve, options, branch, size(x), cancel)
  end subroutine follow_family

  !> The curve with orders up to `highest` of the base frequency.
  subroutine new_curve_of(curve, system, options, highest, status)
    type(free_curve_type), intent(out) :: curve
    class(differentiable_system_type), intent(in), target :: system
    type(free_options), intent(in) :: options
    integer, intent(in) :: highest
    type(status_type), intent(out) :: status
    type(torus_type) :: torus
    integer :: k

    call new_torus(torus, reshape([(k, k=0, highest)], [1, highest + 1]), status)
    if (status%failed()) return
    call new_free_curve(curve, system, torus, options%kept(highest), options%unit, options%dof, &
                        options%order)
  end subroutine new_curve_of

  !> Fail if a family has no point.
  subroutine check_begun(family, curve, status)
    type(free_family_type), intent(in) :: family
    type(curve_options), intent(in) :: curve
    type(status_type), intent(inout) :: status
    if (size(family%nu) > 0) return
    call fail(status, status_input_error, 'from', 'no solution was found at the start ' &
              //show(curve%start)//': start at a smaller value')
  end subroutine check_begun

  subroutine follow_once(curve, options, begin, branch, cancel, begin_nu, begin_p, along)
    type(free_curve_type), intent(inout) :: curve
    type(free_options), intent(in) :: options
    real(wp), intent(in) :: begin(:)
    type(curve_branch_type), intent(out) :: branch
    integer, intent(inout), optional :: cancel
    real(wp), intent(in), optional :: begin_nu, begin_p, along(:)
    real(wp), allocatable :: at(:)
    integer :: n

    if (present(along)) then
      n = size(begin)
      at = unknowns_of(curve, begin, begin_nu/options%unit)
      call follow_curve(curve, options%curve, at, branch, begin_p, &
                        [unknowns_of(curve, along(:n), along(n + 1)), along(n + 2)], cancel)
      return
    end if
    at = unknowns_of(curve, begin, 1.0_wp)
    associate (cosines => at(:curve%motion%n))
      if (options%dof > 0) then
        cosines = cosines*(options%curve%start/cosines(curve%measured))
      else
        cosines = cosines*sqrt(options%curve%start/curve%energy(at))
      end if
    end associate
    call follow_curve(curve, options%curve, at, branch, cancel=cancel)
  end subroutine follow_once

  !> End the branch before the first point that is not finite or whose energy is not.
  subroutine end_with_numbers(curve, branch)
    type(free_curve_type), intent(in) :: curve
    type(curve_branch_type), intent(inout) :: branch
    integer :: i
    call branch%end_with_numbers()
    do i = 1, branch%n_points
      if (ieee_is_finite(curve%energy(branch%x(:, i)))) cycle
      call branch%end_before(i)
      return
    end do
  end subroutine end_with_numbers

  !> Truncation error of each point, and whether to follow the curve again with more harmonics.
  subroutine check(curve, system, options, search, branch, again, status, cancel)
    type(free_curve_type), intent(in) :: curve
    class(differentiable_system_type), intent(in), target :: system
    type(free_options), intent(in) :: options
    type(order_search), intent(inout) :: search
    type(curve_branch_type), intent(inout) :: branch
    logical, intent(out) :: again
    type(status_type), intent(out) :: status
    integer, intent(inout), optional :: cancel
    type(free_curve_type) :: larger
    integer, allocatable :: orders(:)
    integer :: i, k

    again = .false.
    ! If the period is a multiple of the mode's, orders between its harmonics are rounded up.
    orders = [((k + options%order - 1)/options%order, k=0, search%highest*options%order)]
    do i = 1, branch%n_points
      call search%look_at(orders, reshape(cosines_of(curve, branch%x(:, i)), &
                                          [size(orders), system%n_dof]), &
                          [(1.0_wp, k=1, system%n_dof)])
    end do
    call new_curve_of(larger, system, options, search%checking_order()*options%order, status)
    if (status%failed()) return
    call search%check(larger, enlarged(branch%x(:, :branch%n_points)), &
                      enlarged(branch%folds%x(:, :branch%folds%n)), branch, again, cancel)

  contains

    !> Extend the unknowns to the larger set.
    pure function enlarged(x) result(y)
      real(wp), intent(in) :: x(:, :)
      real(wp), allocatable :: y(:, :)
      integer :: k
      allocate (y(larger%n, size(x, 2)))
      do k = 1, size(x, 2)
        y(:, k) = unknowns_of(larger, refitted(system%n_dof, cosines_of(curve, x(:, k)), &
                                               larger%n_cosines()), x(curve%n, k))
      end do
    end function enlarged

  end subroutine check

  !> Store the points of the family, with Floquet multipliers.
  subroutine keep(family, curve, options, branch, n_cosines, cancel)
    type(free_family_type), intent(inout) :: family
    type(free_curve_type), intent(inout) :: curve
    type(free_options), intent(in) :: options
    type(curve_branch_type), intent(in) :: branch
    integer, intent(in) :: n_cosines
    integer, intent(inout), optional :: cancel
    type(orbit_floquet_type) :: floquet
    real(wp) :: r(curve%n), slope(curve%n), jacobian(curve%n, curve%n)
    logical :: inside
    integer :: i, n

    n = branch%n_points
    family%outcome = branch%outcome
    family%parameter = branch%parameter(:n)
    family%truncation = branch%truncation(:n)
    family%error = branch%error(:n)
    family%off = branch%off(:n)
    family%folds = branch%folds%p(:branch%folds%n)
    family%fold_errors = branch%folds%error(:branch%folds%n)
    allocate (family%nu(n), family%energy(n), family%x(n_cosines, n), source=0.0_wp)
    if (options%stability) allocate (family%multipliers(2*curve%motion%system%n_dof, n), &
                                     source=(0.0_wp, 0.0_wp))
    do i = 1, n
      if (is_set(cancel)) exit
      associate (point => branch%x(:, i))
        family%x(:, i) = cosines_of(curve, point)
        family%nu(i) = curve%frequency(point)
        family%energy(i) = curve%energy(point)
        if (.not. options%stability) cycle
        call curve%equations(point, branch%parameter(i), r, jacobian, slope, inside)
        call floquet%multipliers(curve%motion, point(:curve%motion%n), family%multipliers(:, i))
      end associate
    end do
    associate (points => branch%branch_points)
      family%branch_p = points%p(:points%n)
      family%branch_before = points%before(:points%n)
      allocate (family%branch_nu(points%n), family%branch_x(n_cosines, points%n), &
                family%across(n_cosines + 2, points%n))
      do i = 1, points%n
        family%branch_nu(i) = curve%frequency(points%x(:, i))
        family%branch_x(:, i) = cosines_of(curve, points%x(:, i))
        family%across(:, i) = [cosines_of(curve, points%across(:, i)), points%across(curve%n:, i)]
      end do
    end associate
  end subroutine keep

  !> Unknowns of the curve from all cosines and the last unknown.
  pure function unknowns_of(curve, cosines, last) result(unknowns)
    type(free_curve_type), intent(in) :: curve
    real(wp), intent(in) :: cosines(:), last
    real(wp) :: unknowns(curve%n)
    real(wp), allocatable :: y(:, :)
    integer :: d

    d = curve%motion%system%n_dof
    allocate (y(curve%motion%torus%n, d), source=0.0_wp)
    y(1::2, :) = reshape(cosines, [size(cosines)/d, d])
    unknowns = [curve%motion%reduced(reshape(y, [size(y)])), last]
  end function unknowns_of

  !> All cosines from the unknowns; cosines that are not unknowns are 0.
  pure function cosines_of(curve, unknowns) result(cosines)
    type(free_curve_type), intent(in) :: curve
    real(wp), intent(in) :: unknowns(:)
    real(wp) :: cosines(curve%n_cosines())
    real(wp), allocatable :: y(:, :)
    y = curve%motion%expanded(unknowns(:curve%motion%n))
    cosines = reshape(y(1::2, :), [size(cosines)])
  end function cosines_of

end module viscovib_free_family
