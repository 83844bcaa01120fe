!> A kernel that was fitted to measurements: its file, and what a temperature makes of it.
!!
!! The file is JSON as `write_kernel` and `fit.to_json` of the Python package write it. In a
!! canonical scene the kernel stands as its numbers: kind, then parameters as in the catalogue.
!! A material relaxes at a temperature as at its reference, but a_T times as slowly:
!! R_T(t) = R(t/a_T)/a_T (Ferry, Viscoelastic Properties of Polymers, 1980, ch. 11).
module viscovib_fitted_kernel
  use viscovib_catalogue, only: kernel_abel, kernel_prony, kernel_rabotnov, kernel_rzhanitsyn, &
    kernel_sum_of, kernel_tabulated, new_kernel
  use viscovib_group_reader, only: group_reader
  use viscovib_json_text, only: begin_of, first_element, member, next_element, number_at, &
    numbers_at, word_at
  use viscovib_kernel, only: kernel_type
  use viscovib_kinds, only: wp
  use viscovib_status, only: clipped, fail, status_input_error, status_type
  use viscovib_text_file, only: read_text_file
  implicit none
  private

  public :: read_fitted

  !> J/(mol K), 0 deg C in K.
  real(wp), parameter :: gas_constant = 8.31446261815324_wp, kelvin = 273.15_wp
  !> Factors of time beyond are no material's.
  real(wp), parameter :: most_decades = 60.0_wp

contains

  !> Kind and flat parameters of the kernel at the temperature wanted.
  subroutine read_fitted(reader, kind, p)
    type(group_reader), intent(inout) :: reader
    integer, intent(out) :: kind
    real(wp), allocatable, intent(out) :: p(:)
    class(kernel_type), allocatable :: kernel
    type(status_type) :: status
    character(len=:), allocatable :: path, law
    real(wp), allocatable :: numbers(:), shift(:)
    real(wp) :: temperature, decades
    integer :: code

    kind = 0
    allocate (p(0), numbers(0), shift(0))
    law = 'none'
    temperature = 0.0_wp
    path = reader%read_path('file')
    if (reader%has('file')) then
      call reader%refuse([character(len=13) :: 'numbers', 'shift_law', 'shift_numbers'], &
                         'is in the file already')
      if (reader%status%failed()) return
      call read_file(path, numbers, law, shift, temperature, status)
      if (status%failed()) then
        call reader%complain('file', 'file: '//status%message, status%category)
        return
      end if
      call reader%echo_reals('numbers', numbers)
      reader%echo = reader%echo//"  shift_law = '"//law//"'"//new_line('a')
      call reader%echo_reals('shift_numbers', shift)
    else
      if (.not. reader%has('numbers')) then
        call reader%complain('kernel', "kind = 'fitted' lacks file, a fit as Python writes it")
        return
      end if
      numbers = reader%read_reals('numbers')
      law = reader%read_text('shift_law')
      if (reader%may_have('shift_numbers')) shift = reader%read_reals('shift_numbers')
      if (size(shift) > 0) temperature = reference_of(law, shift)
    end if
    if (law == 'none') then
      call reader%refuse(['temperature'], 'this kernel has no shift law')
      decades = 0.0_wp
    else
      temperature = reader%read_real('temperature', temperature)
      call shift_of(law, shift, temperature, decades, status)
      call reader%place(status)
    end if
    if (reader%status%failed()) return
    if (size(numbers) < 2) then
      call reader%complain('numbers', 'numbers: must be a kind and its parameters')
      return
    end if
    code = nint(max(min(numbers(1), 1000.0_wp), -1000.0_wp))
    kind = code
    p = numbers(2:)
    ! An invalid kernel is reported and not scaled.
    call new_kernel(kernel, kind, p, status)
    if (abs(decades) > 0.0_wp .and. .not. status%failed()) then
      call scale_times(kind, p, 10.0_wp**(-decades))
    end if
  end subroutine read_fitted

  !> Numbers of kernel and law in a file, and the temperature there.
  subroutine read_file(path, numbers, law, shift, temperature, status)
    character(len=*), intent(in) :: path
    real(wp), allocatable, intent(out) :: numbers(:), shift(:)
    character(len=:), allocatable, intent(out) :: law
    real(wp), intent(out) :: temperature
    type(status_type), intent(out) :: status
    character(len=:), allocatable :: text
    real(wp), allocatable :: other(:)
    integer :: whole, place
    logical :: ok

    allocate (numbers(0), shift(0))
    law = 'none'
    temperature = 0.0_wp
    call read_text_file(path, text, status)
    if (status%failed()) return
    whole = begin_of(text)
    if (word_at(text, member(text, whole, 'format')) /= 'viscovib kernel') then
      call complain(status, path, "is not a fitted kernel: format must be 'viscovib kernel'")
      return
    end if
    call flat_kernel(text, member(text, whole, 'kernel'), .true., numbers, ok)
    if (.not. ok) then
      call complain(status, path, 'kernel: must be one with a kind that is known and all its ' &
                    //'numbers')
      return
    end if
    place = member(text, whole, 'shift')
    if (place == 0) return
    law = word_at(text, member(text, place, 'kind'))
    select case (law)
    case ('wlf')
      allocate (other(2))
      call number_at(text, member(text, place, 'c1'), other(1), ok)
      if (ok) call number_at(text, member(text, place, 'c2'), other(2), ok)
    case ('arrhenius')
      allocate (other(1))
      call number_at(text, member(text, place, 'activation_energy'), other(1), ok)
    case ('table')
      call numbers_at(text, member(text, place, 'temperatures'), shift, ok)
      if (ok) call numbers_at(text, member(text, place, 'decades'), other, ok)
      if (ok) ok = size(shift) == size(other) .and. size(other) > 1
      if (ok) ok = all(shift(2:) > shift(:size(shift) - 1))
    case default
      ok = .false.
    end select
    if (ok .and. law /= 'table') then
      deallocate (shift)
      allocate (shift(1))
      call number_at(text, member(text, place, 'reference'), shift(1), ok)
    end if
    if (.not. ok) then
      call complain(status, path, 'shift: must be a law with a kind that is known and all its ' &
                    //'numbers')
      return
    end if
    shift = [shift, other]
    temperature = reference_of(law, shift)
    place = member(text, whole, 'temperature')
    if (place > 0) call number_at(text, place, temperature, ok)
    if (.not. ok) call complain(status, path, 'temperature: must be a number')
  end subroutine read_file

  subroutine complain(status, path, message)
    type(status_type), intent(out) :: status
    character(len=*), intent(in) :: path, message
    call fail(status, status_input_error, 'file', clipped(path)//': '//message)
  end subroutine complain

  !> Kind and parameters of the kernel that begins at `place`; a sum holds others, but no sums.
  recursive subroutine flat_kernel(text, place, sums, numbers, ok)
    character(len=*), intent(in) :: text
    integer, intent(in) :: place
    logical, intent(in) :: sums
    real(wp), allocatable, intent(out) :: numbers(:)
    logical, intent(out) :: ok
    real(wp), allocatable :: one(:), other(:)
    integer :: part

    ok = place > 0
    allocate (numbers(0))
    if (.not. ok) return
    select case (word_at(text, member(text, place, 'kind')))
    case ('rzhanitsyn')
      numbers = [real(kernel_rzhanitsyn, wp)]
      call add_members(text, place, [character(len=9) :: 'amplitude', 'alpha', 'beta'], numbers, ok)
    case ('rabotnov')
      numbers = [real(kernel_rabotnov, wp)]
      call add_members(text, place, [character(len=9) :: 'amplitude', 'alpha', 'beta'], numbers, ok)
    case ('abel')
      numbers = [real(kernel_abel, wp)]
      call add_members(text, place, [character(len=9) :: 'amplitude', 'alpha'], numbers, ok)
    case ('prony')
      call two_lists(text, place, 'weights', 'rates', one, other, ok)
      numbers = [real(kernel_prony, wp), one, other]
    case ('tabulated')
      call two_lists(text, place, 'times', 'values', one, other, ok)
      numbers = [real(kernel_tabulated, wp), 0.0_wp, one, other]
      if (word_at(text, member(text, place, 'interpolation')) == 'exponential') numbers(2) = 1.0_wp
    case ('sum')
      ok = sums
      numbers = [real(kernel_sum_of, wp)]
      part = first_element(text, member(text, place, 'parts'))
      do while (ok .and. part > 0)
        call flat_kernel(text, part, .false., one, ok)
        if (ok) numbers = [numbers, one(1), real(size(one) - 1, wp), one(2:)]
        part = next_element(text, part)
      end do
      ok = ok .and. size(numbers) > 1
    case default
      ok = .false.
    end select
  end subroutine flat_kernel

  subroutine add_members(text, place, keys, numbers, ok)
    character(len=*), intent(in) :: text, keys(:)
    integer, intent(in) :: place
    real(wp), allocatable, intent(inout) :: numbers(:)
    logical, intent(out) :: ok
    real(wp) :: value
    integer :: i
    ok = .true.
    do i = 1, size(keys)
      call number_at(text, member(text, place, trim(keys(i))), value, ok)
      if (.not. ok) return
      numbers = [numbers, value]
    end do
  end subroutine add_members

  subroutine two_lists(text, place, first, second, one, other, ok)
    character(len=*), intent(in) :: text, first, second
    integer, intent(in) :: place
    real(wp), allocatable, intent(out) :: one(:), other(:)
    logical, intent(out) :: ok
    call numbers_at(text, member(text, place, first), one, ok)
    if (.not. allocated(other)) allocate (other(0))
    if (ok) call numbers_at(text, member(text, place, second), other, ok)
    if (ok) ok = size(one) == size(other)
  end subroutine two_lists

  !> Temperature at which a law is 1: its first number, or where a table passes 0.
  pure real(wp) function reference_of(law, shift) result(at)
    character(len=*), intent(in) :: law
    real(wp), intent(in) :: shift(:)
    integer :: i, n

    at = shift(1)
    if (law /= 'table') return
    n = size(shift)/2
    do i = 1, n - 1
      associate (t => shift(i:i + 1), d => shift(n + i:n + i + 1))
        if (d(1)*d(2) > 0.0_wp) cycle
        at = t(1)
        if (abs(d(2) - d(1)) > 0.0_wp) at = t(1) - d(1)*(t(2) - t(1))/(d(2) - d(1))
        return
      end associate
    end do
  end function reference_of

  !> log10(a_T).
  subroutine shift_of(law, shift, temperature, decades, status)
    character(len=*), intent(in) :: law
    real(wp), intent(in) :: shift(:), temperature
    real(wp), intent(out) :: decades
    type(status_type), intent(out) :: status
    real(wp) :: warmer
    logical :: ok
    integer :: i, n

    decades = 0.0_wp
    ok = size(shift) == merge(3, 2, law == 'wlf') .or. law == 'table'
    if (ok .and. law == 'table') ok = size(shift) >= 4 .and. mod(size(shift), 2) == 0
    if (.not. ok) then
      call fail(status, status_input_error, 'shift_numbers', &
                'shift_numbers: must be those of the law')
      return
    end if
    warmer = temperature - shift(1)
    select case (law)
    case ('wlf')
      ok = warmer > -shift(3)
      if (ok) decades = -shift(2)*warmer/(shift(3) + warmer)
    case ('arrhenius')
      ok = temperature > -kelvin .and. shift(1) > -kelvin
      if (ok) decades = -shift(2)/(gas_constant*log(10.0_wp))*warmer &
                        /((shift(1) + kelvin)*(temperature + kelvin))
    case default
      n = size(shift)/2
      ok = temperature >= shift(1) .and. temperature <= shift(n)
      do i = 1, n - 1
        if (.not. ok .or. temperature > shift(i + 1)) cycle
        decades = shift(n + i) + (shift(n + i + 1) - shift(n + i)) &
                  *(temperature - shift(i))/(shift(i + 1) - shift(i))
        exit
      end do
    end select
    ok = ok .and. abs(decades) < most_decades
    if (.not. ok) call fail(status, status_input_error, 'temperature', 'temperature: must be one ' &
                            //'for which the shift law of this kernel holds')
  end subroutine shift_of

  !> Times in units of `unit`: unit R(unit t).
  recursive subroutine scale_times(kind, p, unit)
    integer, intent(in) :: kind
    real(wp), intent(inout) :: p(:)
    real(wp), intent(in) :: unit
    integer :: first, length, n

    if (size(p) < 2) return
    select case (kind)
    case (kernel_rzhanitsyn)
      p(1) = p(1)*unit**p(2)
      p(size(p)) = p(size(p))*unit
    case (kernel_abel)
      p(1) = p(1)*unit**p(2)
    case (kernel_rabotnov)
      p(1) = p(1)*unit**p(2)
      p(size(p)) = p(size(p))*unit**p(2)
    case (kernel_prony)
      p = p*unit
    case (kernel_tabulated)
      n = (size(p) - 1)/2
      p(2:n + 1) = p(2:n + 1)/unit
      p(n + 2:) = p(n + 2:)*unit
    case (kernel_sum_of)
      first = 1
      do while (first < size(p))
        if (.not. (p(first + 1) >= 0.0_wp .and. p(first + 1) <= size(p))) return
        length = nint(p(first + 1))
        if (first + 1 + length > size(p)) return
        call scale_times(nint(p(first)), p(first + 2:first + 1 + length), unit)
        first = first + 2 + length
      end do
    case default
    end select
  end subroutine scale_times

end module viscovib_fitted_kernel
