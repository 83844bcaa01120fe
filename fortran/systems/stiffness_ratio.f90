! Optimize: -O1
!> Warnings about stiffness ratios so large that rounding errors hide the soft springs.
!!
!! A mode of unit modal mass has omega^2 = phi^T K phi. Each entry of K has a rounding error of up
!! to half a unit in its last place. The error of omega^2 is then about
!!
!!   0.3 eps sqrt(sum_ij (phi_i K_ij phi_j)^2),                                             (1)
!!
!! (first-order perturbation of a simple eigenvalue, Wilkinson, The Algebraic Eigenvalue Problem,
!! 1965, chapter 2). The root mean square error of an entry is 0.21 eps times the entry; K_ij and
!! K_ji have the same error.
module viscovib_stiffness_ratio
  use viscovib_damped_modes, only: find_damped_modes
  use viscovib_dense, only: invert
  use viscovib_eigenvalues, only: eigenvalues
  use viscovib_kinds, only: wp
  use viscovib_polynomial, only: polynomial_type
  use viscovib_rounded, only: brief
  use viscovib_status, only: show
  use viscovib_symmetric_modes, only: find_symmetric_modes
  implicit none
  private

  public :: entries_type, entries_of, hidden_modes, hidden_poles, hidden_springs

  !> Nonzero entries of a stiffness matrix.
  type :: entries_type
    integer, allocatable :: row(:), column(:)
    real(wp), allocatable :: value(:)
  end type entries_type

  !> Precision for sums with strong cancellation.
  integer, parameter :: wide = selected_real_kind(18)
  !> Relative error of a matrix entry in (1).
  real(wp), parameter :: off = 0.3_wp*epsilon(1.0_wp)
  !> Largest relative rounding error of omega^2 without a warning, and the relative error above
  !! which a mode may be that of a free body.
  real(wp), parameter, public :: least_hidden = 1.0e-6_wp
  real(wp), parameter :: free = 0.15_wp
  !> Kinetic energy fraction above which a coordinate participates in a mode; stiffnesses and
  !! asymmetry below these fractions of the largest entry are rounding errors.
  real(wp), parameter :: taking = 1.0e-3_wp, nothing = 1.0e-30_wp, asymmetric = 1.0e-12_wp
  !> If all squared frequencies are closer together than this, no error exceeds the smallest one
  !! that matters.
  real(wp), parameter :: alike = 1.0e-8_wp

contains

  !> Warning about the least accurate real mode; empty if none.
  !!
  !! A mode smaller than its error belongs to a free body, unless the error is large compared with
  !! the softest coordinate that participates in the mode or is connected to one.
  function hidden_modes(squares, shapes, mass, stiffness, least, first) result(text)
    !> Shapes (m), (n, m) and (n): the diagonal of the mass matrix.
    real(wp), intent(in) :: squares(:), shapes(:, :), mass(:)
    type(entries_type), intent(in) :: stiffness
    !> Largest relative rounding error without a warning.
    real(wp), intent(in) :: least
    !> Number of the first mode.
    integer, intent(in) :: first
    character(len=:), allocatable :: text
    real(wp) :: springs(size(mass)), stiffest, found, frequency, lost, part, softest, top, worst
    logical :: is_free
    integer :: m, at

    text = ''
    if (size(stiffness%value) == 0) return
    top = maxval(abs(stiffness%value))
    springs = diagonal_of(stiffness, size(mass))
    stiffest = 0.0_wp
    do m = 1, size(mass)
      if (mass(m) > 0.0_wp) stiffest = max(stiffest, springs(m)/mass(m))
    end do
    worst = 0.0_wp
    at = 0
    frequency = 0.0_wp
    is_free = .false.
    do m = 1, size(squares)
      ! An upper bound of (1), which most modes pass.
      if (abs(squares(m))*least >= 10.0_wp*off*top*sum(shapes(:, m)**2)) cycle
      lost = off*spread_of(shapes(:, m), stiffness, top)
      if (abs(squares(m))*least >= 10.0_wp*lost) cycle
      ! The eigenvalue solver has errors of the same size; evaluate with the matrix itself.
      found = abs(product_of(shapes(:, m), stiffness))
      part = lost/max(found, tiny(found)/epsilon(found))
      if (part <= max(least, worst) .or. max(found, lost) <= nothing*stiffest) cycle
      softest = softest_nearby(shapes(:, m), mass, springs, stiffness)
      if (part >= free .and. lost <= least_hidden*softest) cycle
      worst = part
      at = m
      is_free = part >= free .or. .not. abs(squares(m)) > 0.0_wp
      frequency = sqrt(merge(max(found, lost), found, is_free))
    end do
    if (at > 0) text = description('mode '//show(first + at - 1), frequency, worst, is_free)
  end function hidden_modes

  !> The nonzero entries of a matrix.
  pure function entries_of(matrix) result(entries)
    real(wp), intent(in) :: matrix(:, :)
    type(entries_type) :: entries
    integer :: i, j, n

    n = count(abs(matrix) > 0.0_wp)
    allocate (entries%row(n), entries%column(n), entries%value(n))
    n = 0
    do j = 1, size(matrix, 2)
      do i = 1, size(matrix, 1)
        if (.not. abs(matrix(i, j)) > 0.0_wp) cycle
        n = n + 1
        entries%row(n) = i
        entries%column(n) = j
        entries%value(n) = matrix(i, j)
      end do
    end do
  end function entries_of

  !> Warning about complex modes, by (1) with left and right vectors and twice the relative error.
  function hidden_poles(poles, left, right, stiffness) result(text)
    !> Shapes (p), (n, p) and (n, n).
    complex(wp), intent(in) :: poles(:), left(:, :), right(:, :)
    real(wp), intent(in) :: stiffness(:, :)
    character(len=:), allocatable :: text
    real(wp) :: lost(size(poles))
    integer :: at

    text = ''
    lost = 2.0_wp*off*spread_between(abs(right), stiffness, abs(left))
    where (abs(poles) > 0.0_wp)
      lost = lost/abs(poles)
    else where
      lost = 0.0_wp
    end where
    at = maxloc(lost, 1)
    if (lost(at) > least_hidden) text = description('a mode', abs(poles(at)), lost(at), .false.)
  end function hidden_poles

  !> Warning about a polynomial system, which is solved in its coordinates, without damping.
  function hidden_springs(system, first) result(text)
    type(polynomial_type), intent(in) :: system
    !> Number of the first mode.
    integer, intent(in) :: first
    character(len=:), allocatable :: text
    real(wp), dimension(size(system%mass, 1), size(system%mass, 1)) :: stiffness, shapes
    complex(wp), dimension(size(system%mass, 1), size(system%mass, 1)) :: inverse
    real(wp) :: squares(size(system%mass, 1))
    complex(wp), dimension(size(system%mass, 1), 2*size(system%mass, 1)) :: left, right
    complex(wp) :: poles(2*size(system%mass, 1)), values(size(system%mass, 1))
    logical :: found, singular
    integer :: i

    text = ''
    if (size(squares) == 1) return
    stiffness = matmul(system%spread, system%gather)
    call invert(cmplx(system%mass, 0.0_wp, wp), inverse, singular)
    if (singular) return
    call eigenvalues(matmul(real(inverse), stiffness), values, found)
    if (found .and. minval(abs(values)) > alike*maxval(abs(values))) return
    if (maxval(abs(stiffness - transpose(stiffness))) <= asymmetric*maxval(abs(stiffness))) then
      call find_symmetric_modes(system%mass, stiffness, squares, shapes)
      text = hidden_modes(squares, shapes, [(system%mass(i, i), i=1, size(squares))], &
                          entries_of(stiffness), least_hidden, first)
    else
      call find_damped_modes(system%mass, 0.0_wp*stiffness, stiffness, poles, left, right, found)
      if (found) text = hidden_poles(poles, left, right, stiffness)
    end if
  end function hidden_springs

  !> Square root in (1) of one mode.
  pure real(wp) function spread_of(shape_of, stiffness, top)
    real(wp), intent(in) :: shape_of(:), top
    type(entries_type), intent(in) :: stiffness
    real(wp) :: total, unit
    integer :: k
    unit = max(maxval(abs(shape_of)), tiny(unit))
    total = 0.0_wp
    do k = 1, size(stiffness%value)
      total = total + (stiffness%value(k)/top*(shape_of(stiffness%row(k))/unit) &
                       *(shape_of(stiffness%column(k))/unit))**2
    end do
    spread_of = top*sqrt(total)*unit*unit
  end function spread_of

  !> Square roots in (1) with right and left vectors, shape (p).
  pure function spread_between(left, stiffness, right) result(root)
    real(wp), intent(in) :: left(:, :), stiffness(:, :), right(:, :)
    real(wp) :: root(size(left, 2)), largest

    root = 0.0_wp
    largest = maxval(abs(stiffness))
    if (.not. largest > 0.0_wp) return
    root = largest*sqrt(sum(left**2*matmul((stiffness/largest)**2, right**2), 1))
  end function spread_between

  !> phi^T K phi, with more digits.
  pure real(wp) function product_of(shape_of, stiffness)
    real(wp), intent(in) :: shape_of(:)
    type(entries_type), intent(in) :: stiffness
    real(wide) :: total
    integer :: k
    total = 0.0_wide
    do k = 1, size(stiffness%value)
      total = total + real(shape_of(stiffness%row(k)), wide)*stiffness%value(k) &
              *shape_of(stiffness%column(k))
    end do
    product_of = real(total, wp)
  end function product_of

  !> Sizes of the diagonal entries.
  pure function diagonal_of(stiffness, n) result(springs)
    type(entries_type), intent(in) :: stiffness
    integer, intent(in) :: n
    real(wp) :: springs(n)
    integer :: k
    springs = 0.0_wp
    do k = 1, size(stiffness%value)
      if (stiffness%row(k) == stiffness%column(k)) then
        springs(stiffness%row(k)) = abs(stiffness%value(k))
      end if
    end do
  end function diagonal_of

  !> Smallest k_ii/m_ii of the coordinates that participate in the mode or are connected to one.
  pure real(wp) function softest_nearby(shape_of, mass, springs, stiffness) result(softest)
    real(wp), intent(in) :: shape_of(:), mass(:), springs(:)
    type(entries_type), intent(in) :: stiffness
    logical :: joined(size(mass))
    real(wp) :: least
    integer :: i, k

    least = nothing*maxval(springs)
    joined = .false.
    do k = 1, size(stiffness%value)
      i = stiffness%column(k)
      if (abs(stiffness%value(k)) > least .and. mass(i)*shape_of(i)**2 > taking) then
        joined(stiffness%row(k)) = .true.
      end if
    end do
    softest = huge(softest)
    do i = 1, size(mass)
      if (joined(i) .and. springs(i) > least .and. mass(i) > 0.0_wp) then
        softest = min(softest, springs(i)/mass(i))
      end if
    end do
  end function softest_nearby

  function description(name, frequency, lost, is_free) result(text)
    character(len=*), intent(in) :: name
    real(wp), intent(in) :: frequency, lost
    logical, intent(in) :: is_free
    character(len=:), allocatable :: text

    if (is_free) then
      text = name//' may be free, or have up to about '//brief(frequency)//' rad/s'
    else
      text = name//' has '//brief(frequency)//' rad/s, and the square of that is known to about ' &
             //brief(lost)//' only'
    end if
    text = 'stiffness: springs are so different that rounding hides the soft ones: '//text &
           //'; stiffer parts may be made rigid, or softer'//new_line('a')
  end function description

end module viscovib_stiffness_ratio
