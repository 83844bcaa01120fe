! Optimize: -O2
!> The base frequencies of a driven system's loads, and the orders of its motion: commensurate loads
!! share an axis of the torus.
module viscovib_drive_torus
  use viscovib_kinds, only: wp
  use viscovib_limits, only: max_harmonics
  use viscovib_status, only: fail, show, status_input_error, status_type
  implicit none
  private

  public :: drive_torus_type, sort_drives, lattice, largest_bound, lowest_bound, default_bound, &
            checking_shells, kept_by_symmetry, n_unknowns

  integer, parameter, public :: n_drives = 3
  character(len=*), parameter, public :: frequency_names(n_drives) = ['p1', 'p2', 'p3'], &
                                         amplitude_names(n_drives) = &
    [character(len=3) :: 'f0', 'm01', 'm02']
  !> Varied quantity: a frequency, 1 to 3; an amplitude, 4 to 6; all frequencies together.
  integer, parameter, public :: varies_nu = 7
  character(len=*), parameter, public :: varied_names(7) = &
    [character(len=3) :: frequency_names, amplitude_names, 'nu']
  !> Largest number of unknowns: with a matrix, which then takes 130 MB and some seconds to
  !! factorize, and with residuals only.
  integer, parameter, public :: max_unknowns = 4000, max_without_matrix = 12000
  !> Two frequencies are commensurate if their ratio differs from a ratio of small integers by less
  !! than this relative tolerance.
  real(wp), parameter :: closeness = 1.0e-12_wp

  type :: drive_torus_type
    integer :: n_axes = 0
    !> Base frequencies, shape (n_axes). The phase of load j is orders(:, j) times their angles,
    !! shape (n_axes, n_drives).
    real(wp), allocatable :: base(:)
    integer, allocatable :: orders(:, :)
    !> Load whose frequency a base frequency equals, 0: a fraction of several, shape (n_axes).
    integer, allocatable :: named(:)
    !> If a frequency varies: its axis, and its multiple of the base frequency.
    integer :: axis = 1, multiple = 1
  end type drive_torus_type

  !> Assignment of loads to axes.
  type :: sorting_type
    real(wp) :: frequency(n_drives) = 0.0_wp
    !> True if only one axis is allowed.
    logical :: single = .false.
    integer :: n_axes = 0
    !> The first load on each axis; the axis of each load, 0: it does not act; and the ratio
    !! top/bottom of its frequency to that of the first load.
    integer, dimension(n_drives) :: first = 0, axis = 0, top = 1, bottom = 1
  contains
    procedure :: place
    procedure :: whole
    procedure :: largest_multiple
    procedure :: base_frequencies
  end type sorting_type

contains

  !> Sort the active loads by frequency. A frequency that varies keeps an axis of its own; "nu"
  !! varies all of them together.
  subroutine sort_drives(torus, frequency, amplitude, varies, subharmonic, max_denominator, status)
    type(drive_torus_type), intent(out) :: torus
    real(wp), intent(in) :: frequency(n_drives), amplitude(n_drives)
    !> One of `varied_names`, or 0.
    integer, intent(in) :: varies
    !> Period of the motion in periods of the loads.
    integer, intent(in) :: subharmonic
    !> Largest integers in a ratio that counts as commensurate.
    integer, intent(in) :: max_denominator
    type(status_type), intent(out) :: status
    type(sorting_type) :: sorting
    logical :: acts(n_drives)
    integer :: j

    acts = abs(amplitude) > 0.0_wp
    if (varies >= 1 .and. varies <= n_drives) then
      if (.not. acts(varies)) then
        call fail(status, status_input_error, 'parameter', frequency_names(varies) &
                  //': varies, but no load acts at it: '//trim(amplitude_names(varies))//' = 0')
        return
      end if
    end if
    sorting%frequency = frequency
    ! All loads on one axis, however low their base frequency is.
    sorting%single = subharmonic > 1 .or. varies == varies_nu
    do j = 1, n_drives
      if (.not. (acts(j) .or. varies == n_drives + j)) cycle
      if (varies == j .or. frequency(j) > 0.0_wp) call sorting%place(j, varies, max_denominator)
    end do
    if (sorting%n_axes == 0) then
      call fail(status, status_input_error, 'parameter', &
                'f0, m01, m02: at least one load of a frequency > 0 must act')
    else if (sorting%n_axes > 1 .and. sorting%single) then
      call refuse_axes(sorting, subharmonic, status)
    end if
    if (status%failed()) return
    call sorting%base_frequencies(subharmonic, torus)
    if (lowest_bound(torus) > max_harmonics) then
      call fail(status, status_input_error, 'max_denominator', 'max_denominator = ' &
                //show(max_denominator)//': the loads are up to '//show(lowest_bound(torus)) &
                //' times their base frequency, must be at most '//show(max_harmonics))
    else if (varies >= 1 .and. varies <= n_drives) then
      torus%axis = sorting%axis(varies)
      torus%multiple = torus%orders(torus%axis, varies)
    end if
  end subroutine sort_drives

  !> Place load j on the first axis whose frequency has a ratio of small integers to its own, and
  !! small multiples for all loads on it.
  subroutine place(self, j, varies, most)
    class(sorting_type), intent(inout) :: self
    integer, intent(in) :: j, varies, most
    integer :: i

    do i = 1, self%n_axes
      if (varies == j .or. varies == self%first(i)) cycle
      call find_ratio(self%frequency(j), self%frequency(self%first(i)), most, self%top(j), &
                      self%bottom(j))
      if (self%bottom(j) == 0) cycle
      self%axis(j) = i
      if (self%single .or. self%largest_multiple(i) <= most) return
    end do
    self%n_axes = self%n_axes + 1
    self%axis(j) = self%n_axes
    self%first(self%n_axes) = j
    self%top(j) = 1
    self%bottom(j) = 1
  end subroutine place

  !> The lowest common multiple of the denominators on an axis.
  pure integer function whole(self, i)
    class(sorting_type), intent(in) :: self
    integer, intent(in) :: i
    integer :: j
    whole = 1
    do j = 1, n_drives
      if (self%axis(j) == i) whole = whole/gcd(whole, self%bottom(j))*self%bottom(j)
    end do
  end function whole

  !> The largest multiple of the base frequency among the loads on an axis.
  pure integer function largest_multiple(self, i)
    class(sorting_type), intent(in) :: self
    integer, intent(in) :: i
    largest_multiple = maxval(self%top*(self%whole(i)/self%bottom), self%axis == i)
  end function largest_multiple

  !> Compute the base frequency of each axis; its loads are multiples of it.
  subroutine base_frequencies(self, subharmonic, torus)
    class(sorting_type), intent(in) :: self
    integer, intent(in) :: subharmonic
    type(drive_torus_type), intent(inout) :: torus
    integer :: i, j, multiple, common

    torus%n_axes = self%n_axes
    allocate (torus%base(self%n_axes), torus%orders(self%n_axes, n_drives), &
              torus%named(self%n_axes))
    torus%orders = 0
    do i = 1, self%n_axes
      multiple = self%whole(i)*subharmonic
      common = multiple
      do j = 1, n_drives
        if (self%axis(j) == i) common = gcd(common, self%top(j)*(multiple/self%bottom(j)))
      end do
      if (subharmonic > 1) common = 1
      where (self%axis == i) torus%orders(i, :) = self%top*(multiple/self%bottom)/common
      multiple = multiple/common
      torus%base(i) = self%frequency(self%first(i))/multiple
      torus%named(i) = merge(self%first(i), 0, multiple == 1 .and. count(self%axis == i) == 1)
    end do
  end subroutine base_frequencies

  subroutine refuse_axes(sorting, subharmonic, status)
    type(sorting_type), intent(in) :: sorting
    integer, intent(in) :: subharmonic
    type(status_type), intent(out) :: status
    character(len=:), allocatable :: values, what
    integer :: i

    values = show(sorting%frequency(sorting%first(1)))
    do i = 2, sorting%n_axes
      values = values//', '//show(sorting%frequency(sorting%first(i)))
    end do
    what = 'nu'
    if (subharmonic > 1) what = 'subharmonic = '//show(subharmonic)
    call fail(status, status_input_error, merge('subharmonic', 'parameter  ', subharmonic > 1), &
              what//': needs a single base frequency, but those of the loads are ' &
              //'incommensurate ('//values//')')
  end subroutine refuse_axes

  !> value = top/bottom times another, with integers up to `most`; bottom = 0 if there are none.
  pure subroutine find_ratio(value, another, most, top, bottom)
    real(wp), intent(in) :: value, another
    integer, intent(in) :: most
    integer, intent(out) :: top, bottom
    real(wp) :: ratio
    ratio = value/another
    top = 0
    do bottom = 1, most
      if (.not. ratio*bottom < most + 0.5_wp) exit
      top = nint(ratio*bottom)
      if (top < 1 .or. top > most) cycle
      if (abs(real(top, wp)/bottom*another - value) <= closeness*value) return
    end do
    bottom = 0
  end subroutine find_ratio

  pure integer function gcd(a, b)
    integer, intent(in) :: a, b
    integer :: rest, other
    gcd = a
    rest = b
    do while (rest > 0)
      other = modulo(gcd, rest)
      gcd = rest
      rest = other
    end do
  end function gcd

  !> The smallest bound of a lattice that contains all loads.
  pure integer function lowest_bound(torus)
    type(drive_torus_type), intent(in) :: torus
    lowest_bound = max(1, maxval(sum(abs(torus%orders), 1)))
  end function lowest_bound

  !> Number of additional shells that estimate the truncation error of a bound.
  pure integer function checking_shells(torus) result(shells)
    type(drive_torus_type), intent(in) :: torus
    integer :: j
    shells = 2
    if (torus%n_axes > 1) return
    shells = 0
    do j = 1, size(torus%orders, 2)
      shells = gcd(shells, abs(torus%orders(1, j)))
    end do
    shells = 2*max(shells, 1)
  end function checking_shells

  !> Half of the orders with |k_1| + |k_2| + ... <= bound, shell by shell, 0 first, shape (n_axes,
  !! n).
  pure function lattice(n_axes, bound) result(orders)
    integer, intent(in) :: n_axes, bound
    integer, allocatable :: orders(:, :)
    integer :: s, n

    ! Counted first, then filled.
    n = 0
    do s = 0, bound
      call add_shell(n_axes, s, n)
    end do
    allocate (orders(3, n))
    n = 0
    do s = 0, bound
      call add_shell(n_axes, s, n, orders)
    end do
    orders = orders(:n_axes, :)
  end function lattice

  !> Add the orders of one shell, |k_1| + |k_2| + |k_3| = s.
  pure subroutine add_shell(n_axes, s, n, orders)
    integer, intent(in) :: n_axes, s
    integer, intent(inout) :: n
    integer, intent(inout), optional :: orders(:, :)
    integer :: i, j, k, second, third

    do i = s, 0, -1
      second = merge(s - i, 0, n_axes > 1)
      do j = second, -second, -1
        third = merge(s - i - abs(j), 0, n_axes > 2)
        do k = third, -third, -1
          if (i + abs(j) + abs(k) /= s) cycle
          if (.not. (i > 0 .or. (i == 0 .and. (j > 0 .or. (j == 0 .and. k >= 0))))) cycle
          n = n + 1
          if (present(orders)) orders(:, n) = [i, j, k]
        end do
      end do
    end do
  end subroutine add_shell

  !> Unknowns of three coordinates: three for each point of the whole lattice.
  pure integer function n_unknowns(n_axes, bound)
    integer, intent(in) :: n_axes, bound
    select case (n_axes)
    case (1)
      n_unknowns = 3*(2*bound + 1)
    case (2)
      n_unknowns = 3*(2*bound*(bound + 1) + 1)
    case default
      n_unknowns = (2*bound + 1)*(2*bound*(bound + 1) + 3)
    end select
  end function n_unknowns

  !> Largest bound for which `share` of the unknowns is at most `most`.
  pure integer function largest_bound(n_axes, share, most) result(bound)
    integer, intent(in) :: n_axes, most
    real(wp), intent(in) :: share
    bound = 1
    do while (share*n_unknowns(n_axes, bound + 1) <= most .and. bound < max_harmonics)
      bound = bound + 1
    end do
  end function largest_bound

  !> Default highest orders on a branch: some beyond those of the loads.
  pure integer function default_bound(torus)
    type(drive_torus_type), intent(in) :: torus
    integer, parameter :: bounds(3) = [15, 6, 4]
    default_bound = min(max(bounds(torus%n_axes), 2*lowest_bound(torus) + 1), &
                        max(lowest_bound(torus), largest_bound(torus%n_axes, 1.0_wp, max_unknowns)))
  end function default_bound

  !> True if an order of a coordinate (z, phi, psi) is an unknown, shape (n_orders, 3).
  !!
  !! The mirrored motion (z, -phi, -psi) belongs to mirrored moments m01, m02. If a shift of the
  !! angles by half turns mirrors these and does not change f0, the motion that starts from zero is
  !! its own shifted mirror image: an order that is shifted by an even number of half turns vanishes
  !! in phi and psi, any other one in z.
  pure function kept_by_symmetry(torus, orders, amplitude, varies) result(kept)
    type(drive_torus_type), intent(in) :: torus
    integer, intent(in) :: orders(:, :)
    real(wp), intent(in) :: amplitude(n_drives)
    integer, intent(in) :: varies
    logical :: kept(size(orders, 2), 3)
    integer :: shift(torus%n_axes), mirrored(n_drives), i, j, code
    logical :: acts(n_drives), odd(size(orders, 2))

    mirrored = [0, 1, 1]
    acts = [(abs(amplitude(j)) > 0.0_wp .or. varies == n_drives + j, j=1, n_drives)]
    kept = .true.
    do code = 0, 2**torus%n_axes - 1
      shift = [(ibits(code, torus%n_axes - i, 1), i=1, torus%n_axes)]
      if (any(acts .and. modulo(matmul(shift, torus%orders), 2) /= mirrored)) cycle
      odd = modulo(matmul(shift, orders), 2) == 1
      kept(:, 1) = .not. odd
      kept(:, 2) = odd
      kept(:, 3) = odd
      return
    end do
  end function kept_by_symmetry

end module viscovib_drive_torus
